"""A long corridor in which nothing shows a laser how far it has come."""

from __future__ import annotations

from mapmyworld.simulation.solids import wall
from mapmyworld.simulation.world import Ground, World

_WEST, _EAST, _HALF_WIDTH = -3.0, 97.0, 1.0

CORRIDOR = World(
    name="corridor",
    about="100 m of bare walls: along it, only the ends show a laser where it is",
    solids=(
        *wall((_WEST, -_HALF_WIDTH), (_EAST, -_HALF_WIDTH), "plain:white"),
        *wall((_EAST, -_HALF_WIDTH), (_EAST, _HALF_WIDTH), "plain:white"),
        *wall((_EAST, _HALF_WIDTH), (_WEST, _HALF_WIDTH), "plain:white"),
        *wall((_WEST, _HALF_WIDTH), (_WEST, -_HALF_WIDTH), "plain:white"),
    ),
    grounds=(Ground((_WEST, -_HALF_WIDTH, _EAST, _HALF_WIDTH), "plain:grey", "plain:white"),),
    routes={"default": "92,0", "return": "92,0 turn:180 0,0"},
)
