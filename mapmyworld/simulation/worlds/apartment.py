"""A small flat: lounge, kitchen and balcony, joined by doors to a round tour."""

from __future__ import annotations

from mapmyworld.simulation.solids import Box, Opening, Post, wall
from mapmyworld.simulation.world import Ground, World

_LOUNGE = (-2.0, -2.2, 4.6, 2.6)
_KITCHEN = (4.6, -2.2, 8.6, 2.6)
_BALCONY = (-2.0, 2.6, 8.6, 4.8)


def _legs(x: float, y: float, dx: float, dy: float, radius: float, top: float) -> list[Box | Post]:
    return [
        Post(x + sx * dx, y + sy * dy, radius, 0.0, top, "wood") for sx in (-1, 1) for sy in (-1, 1)
    ]


def _table(x: float, y: float, length: float, width: float, height: float) -> list[Box | Post]:
    legs = _legs(x, y, length / 2 - 0.06, width / 2 - 0.06, 0.03, height)
    return [*legs, Box(x, y, length, width, height, height + 0.04, "planks")]


def _chair(x: float, y: float, yaw_deg: float) -> list[Box | Post]:
    back = {0.0: (0.2, 0.0), 90.0: (0.0, 0.2), 180.0: (-0.2, 0.0), 270.0: (0.0, -0.2)}[yaw_deg]
    return [
        *_legs(x, y, 0.18, 0.18, 0.02, 0.45),
        Box(x, y, 0.42, 0.42, 0.45, 0.49, "fabric:3"),
        Box(x + back[0], y + back[1], 0.04, 0.4, 0.49, 0.95, "wood", yaw_deg),
    ]


def _picture(x: float, y: float, yaw_deg: float, number: int, width: float = 0.8) -> Box:
    bottom = 0.7
    return Box(x, y, width, 0.03, bottom, bottom + 0.6, f"picture:{number}", yaw_deg, stretch=True)


_WALLS = (
    *wall((-2.0, -2.2), (8.6, -2.2), "wallpaper:1", [Opening(6.9, 1.4, 0.9, 2.0, glass=True)]),
    *wall((8.6, -2.2), (8.6, 2.6), "wallpaper:2"),
    *wall(
        (-2.0, 2.6),
        (8.6, 2.6),
        "brick",
        [Opening(2.0, 1.0), Opening(4.6, 1.6, 0.0, 2.1, True), Opening(9.2, 1.0)],
    ),
    *wall((-2.0, 2.6), (-2.0, -2.2), "wallpaper:3"),
    *wall((4.6, -2.2), (4.6, 2.6), "wallpaper:4", [Opening(1.5, 1.0)]),
)

_RAILING = (
    *wall((-2.0, 2.6), (-2.0, 4.8), "brick"),
    *wall((8.6, 4.8), (8.6, 2.6), "brick"),
    *wall((-2.0, 4.8), (8.6, 4.8), "planks", height=0.95, thickness=0.06),
)

_LOUNGE_THINGS = (
    Box(-1.45, -0.6, 0.9, 2.0, 0.0, 0.42, "fabric:1"),
    Box(-1.80, -0.6, 0.25, 2.0, 0.42, 0.85, "fabric:1"),
    *_table(0.9, -1.3, 1.1, 0.6, 0.42),
    Box(3.4, -1.95, 1.8, 0.35, 0.0, 1.9, "books:1"),
    Box(1.0, -2.05, 1.4, 0.2, 0.0, 0.5, "wood"),
    Box(3.2, 2.35, 1.2, 0.35, 0.0, 1.1, "books:2"),
    Post(4.2, 2.2, 0.18, 0.0, 0.45, "terracotta"),
    Post(4.2, 2.2, 0.28, 0.45, 1.2, "leaves"),
    _picture(-1.92, 1.2, 90.0, 101),
    _picture(1.0, -2.12, 0.0, 102, 1.1),
    _picture(4.52, 1.0, 90.0, 103),
    _picture(4.52, -1.6, 90.0, 104, 0.6),
    _picture(-0.9, 2.52, 0.0, 105),
)

_KITCHEN_THINGS = (
    Box(8.24, -0.4, 0.6, 3.2, 0.0, 0.9, "tiles:2"),
    Box(8.24, -0.4, 0.62, 3.22, 0.9, 0.94, "marble"),
    Box(8.35, -0.4, 0.35, 2.6, 1.5, 2.1, "planks"),
    Box(8.25, 2.15, 0.6, 0.7, 0.0, 1.8, "picture:120", stretch=True),
    *_table(5.7, 1.55, 1.0, 0.8, 0.72),
    *_chair(5.7, 0.85, 270.0),
    *_chair(5.0, 1.6, 180.0),
    Box(5.0, -1.95, 0.6, 0.35, 0.0, 1.2, "books:3"),
    _picture(6.2, 2.52, 0.0, 111),
    _picture(4.68, 0.4, 90.0, 112, 0.6),
)

_BALCONY_THINGS = (
    Post(8.1, 4.3, 0.22, 0.0, 0.5, "terracotta"),
    Post(8.1, 4.3, 0.32, 0.5, 1.3, "leaves"),
    Post(-1.6, 4.4, 0.22, 0.0, 0.4, "terracotta"),
    Post(-1.6, 4.4, 0.30, 0.4, 1.1, "leaves"),
    Box(4.0, 4.52, 1.4, 0.35, 0.0, 0.45, "planks"),
    Box(1.6, 4.6, 0.6, 0.25, 0.0, 0.4, "terracotta"),
    _picture(6.0, 2.68, 0.0, 121, 0.7),
    _picture(1.3, 2.68, 0.0, 122, 0.7),
)

_TOUR = "2.6,-0.5 4.6,-0.7 6.6,-0.7 7.2,0.6 7.2,2.6 7.0,3.6 0.4,3.6 0,2.6 0,0.9 0,0"

APARTMENT = World(
    name="apartment",
    about="lounge, kitchen and balcony of a flat, 11 x 7 m: furniture, pictures, glass",
    solids=(*_WALLS, *_RAILING, *_LOUNGE_THINGS, *_KITCHEN_THINGS, *_BALCONY_THINGS),
    grounds=(
        Ground(_LOUNGE, "planks", "plain:white"),
        Ground(_KITCHEN, "tiles:1", "plain:white"),
        Ground(_BALCONY, "concrete"),
    ),
    routes={
        "default": _TOUR,
        "short": f"{_TOUR} 2.6,-0.5",
        "second": "start:7.2,0.6,-90 6.6,-0.7 4.6,-0.7 2.6,-0.5 0,0 0,2.6 0.4,3.6 7.0,3.6 7.2,0.6",
        "reversal": "2.6,-0.5 <0,0 2.6,-0.5 4.6,-0.7 6.6,-0.7 <4.6,-0.7 <2.6,-0.5 turn:180 0,0",
        "kidnap": "2.6,-0.5 4.6,-0.7 6.6,-0.7 kidnap:7.0,3.6,180 0.4,3.6 0,2.6 0,0 2.6,-0.5",
    },
    laps=3,
)
