"""A long corridor in which nothing shows a laser how far it has come."""

from __future__ import annotations

from mapmyworld.simulation.solids import walls_around
from mapmyworld.simulation.world import Ground, World

_EXTENT = (-3.0, -1.0, 97.0, 1.0)

CORRIDOR = World(
    name="corridor",
    about="100 m of bare walls: along it, only the ends show a laser where it is",
    solids=walls_around(_EXTENT, "plain:white"),
    grounds=(Ground(_EXTENT, "plain:grey", "plain:white"),),
    routes={"default": "92,0", "return": "92,0 turn:180 0,0"},
)
