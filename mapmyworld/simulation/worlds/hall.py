"""A bare rectangular hall made to provoke missed and false loop closures.

Along the walls, seen from a robot that drives round them: pictures of which each hangs only once
(rich sections), nothing at all (blank sections), and the very same pictures again and again
(repeating sections). A laser sees four walls and nothing else.
"""

from __future__ import annotations

from mapmyworld.simulation.solids import Box, walls_around
from mapmyworld.simulation.world import Ground, World

_WEST, _SOUTH, _EAST, _NORTH = _EXTENT = -2.5, -2.0, 11.5, 7.0
_PICTURE = (1.1, 0.9)  # m, width and height
_DEPTH = 0.02  # m by which a picture stands off the wall
_SPACING = 1.3  # m between the middles of neighbours
_INNER = 0.06  # m, half a wall's thickness


def _picture(x: float, y: float, yaw_deg: float, name: str) -> Box:
    width, height = _PICTURE
    return Box(x, y, width, _DEPTH, 0.45, 0.45 + height, name, yaw_deg, stretch=True)


def _along_x(first: float, y: float, names: list[str]) -> list[Box]:
    return [_picture(first + i * _SPACING, y, 0.0, name) for i, name in enumerate(names)]


def _along_y(x: float, first: float, names: list[str]) -> list[Box]:
    return [_picture(x, first + i * _SPACING, 90.0, name) for i, name in enumerate(names)]


_SAME = ["picture:900", "picture:901"]
_south = _SOUTH + _INNER + _DEPTH / 2
_north = _NORTH - _INNER - _DEPTH / 2
_east = _EAST - _INNER - _DEPTH / 2
_west = _WEST + _INNER + _DEPTH / 2

HALL = World(
    name="hall",
    about="14 x 9 m, bare: rich, featureless and exactly repeating sections of wall",
    solids=(
        *walls_around(_EXTENT, "plain:cream"),
        *_along_x(-1.5, _south, [f"picture:{n}" for n in range(1, 5)]),
        *_along_x(6.5, _south, _SAME * 2),
        *_along_y(_east, -1.0, [f"picture:{n}" for n in range(11, 15)]),
        *_along_y(_east, 5.0, _SAME),
        *_along_x(-1.5, _north, _SAME * 2),
        *_along_x(7.5, _north, [f"picture:{n}" for n in range(21, 24)]),
        *_along_y(_west, -1.0, [f"picture:{n}" for n in range(31, 33)]),
        *_along_y(_west, 4.5, _SAME),
    ),
    grounds=(Ground(_EXTENT, "plain:grey", "plain:white"),),
    routes={
        "default": "9,0 9,5 0,5 0,0",
        "short": "9,0 9,5 0,5 0,0 4,0",
        "second": "start:9,5,180 0,5 0,0 9,0 9,5",
        "across": "9,0 9,5 0,0 0,5 9,0",
        "kidnap": "9,0 9,5 kidnap:0,5,-90 0,0 9,0",
    },
    laps=3,
)
