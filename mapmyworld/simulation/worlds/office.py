"""An office floor: a round tour of corridors between rooms that all look the same."""

from __future__ import annotations

from mapmyworld.simulation.solids import Box, Opening, Post, wall, walls_around
from mapmyworld.simulation.world import Ground, World

_WEST, _EAST, _SOUTH, _NORTH = -6.0, 36.0, 0.0, 20.5  # m, centre lines of the corridors
_HALF = 1.0  # m, half a corridor's width
_DEEP = 6.0  # m, depth of the rooms outside the corridors
_ROOM = 4.2  # m, width of a room
_DOOR = 0.9  # m
_OPEN_EVERY = 3  # the doors of every third room stand open, the others are shut
_RECESS = 0.10  # m by which a shut door lies behind the wall's surface
_WALL = "plain:white"


def _row(start: tuple[float, float], length: float, yaw: int, first: int) -> list[Box | Post]:
    """A row of rooms to the right of a corridor's wall that runs along `yaw` (quarter turns)."""
    dx, dy = ((1, 0), (0, 1), (-1, 0), (0, -1))[yaw]
    count = int(length // _ROOM)
    margin = (length - count * _ROOM) / 2.0
    doors = [margin + (i + 0.5) * _ROOM for i in range(count)]
    end = (start[0] + dx * length, start[1] + dy * length)
    parts: list[Box | Post] = [*wall(start, end, _WALL, [Opening(at, _DOOR) for at in doors])]
    for i, at in enumerate(doors):
        if (i + first) % _OPEN_EVERY:
            depth = 0.06 + _RECESS
            x, y = start[0] + dx * at + dy * depth, start[1] + dy * at - dx * depth
            parts.append(Box(x, y, _DOOR + 0.1, 0.06, 0.0, 2.0, "wood", 90.0 * yaw))
    for i in range(count):
        along = margin + i * _ROOM
        parts += _room(start[0] + dx * along, start[1] + dy * along, yaw, _DEEP)
    return parts


def _room(x: float, y: float, yaw: int, depth: float) -> list[Box | Post]:
    """Partition and furniture of one room; (x, y) is its corner at the corridor."""
    dx, dy = ((1, 0), (0, 1), (-1, 0), (0, -1))[yaw]

    def place(along: float, deep: float) -> tuple[float, float]:
        return x + dx * along + dy * deep, y + dy * along - dx * deep

    far = place(0.0, depth)
    desk, shelf = place(1.0, depth - 1.2), place(_ROOM - 0.35, depth / 2.0)
    return [
        *wall((x, y), far, _WALL),
        Box(*desk, 1.4, 0.7, 0.0, 0.72, "planks", 90.0 * yaw),
        Box(*shelf, 0.4, 1.6, 0.0, 1.9, "books:4", 90.0 * yaw),
    ]


_OUT_W, _OUT_E = _WEST - _HALF, _EAST + _HALF
_OUT_S, _OUT_N = _SOUTH - _HALF, _NORTH + _HALF
_IN_W, _IN_E = _WEST + _HALF, _EAST - _HALF
_IN_S, _IN_N = _SOUTH + _HALF, _NORTH - _HALF
_EXTENT = _OUT_W - _DEEP, _OUT_S - _DEEP, _OUT_E + _DEEP, _OUT_N + _DEEP

_ROWS = (
    *_row((_OUT_W, _OUT_S), _OUT_E - _OUT_W, 0, 0),
    *_row((_OUT_E, _OUT_S), _OUT_N - _OUT_S, 1, 1),
    *_row((_OUT_E, _OUT_N), _OUT_W * -1 + _OUT_E, 2, 2),
    *_row((_OUT_W, _OUT_N), _OUT_N - _OUT_S, 3, 0),
    *_row((_IN_E, _IN_S), _IN_E - _IN_W, 2, 1),
    *_row((_IN_W, _IN_N), _IN_E - _IN_W, 0, 0),
    *wall((_IN_W, _IN_N), (_IN_W, _IN_S), _WALL),
    *wall((_IN_E, _IN_S), (_IN_E, _IN_N), _WALL),
)

_SHELL = (
    *walls_around(_EXTENT, _WALL),
    *wall((_IN_W, _IN_S + _DEEP), (_IN_E, _IN_S + _DEEP), _WALL),
    *wall((_IN_E, _IN_N - _DEEP), (_IN_W, _IN_N - _DEEP), _WALL),
)

_LANDMARKS: tuple[Box | Post, ...] = (
    Box(12.0, _OUT_S + 0.30, 0.8, 0.4, 0.0, 1.2, "picture:201", stretch=True),
    Post(_OUT_E - 0.35, 9.0, 0.22, 0.0, 0.6, "terracotta"),
    Box(20.0, _OUT_N - 0.28, 1.2, 0.35, 0.0, 1.8, "books:5"),
    Box(_OUT_W + 0.28, 12.0, 0.35, 0.9, 0.0, 1.0, "picture:202", stretch=True),
    *(
        Box(x, y, 0.9, 0.03, 0.6, 1.3, f"picture:{210 + i}", stretch=True)
        for i, (x, y) in enumerate(
            [
                (2.2, _OUT_S + 0.08),
                (19.0, _OUT_S + 0.08),
                (27.4, _IN_S - 0.08),
                (6.4, _OUT_N - 0.08),
                (27.4, _OUT_N - 0.08),
                (-2.0, _IN_S - 0.08),
            ]
        )
    ),
)

OFFICE = World(
    name="office",
    about="56 x 35 m: a loop of corridors, 125 m round, between equal rooms behind equal doors",
    solids=(*_ROWS, *_SHELL, *_LANDMARKS),
    grounds=(Ground(_EXTENT, "carpet", "plain:white"),),
    routes={
        "default": f"{_EAST},{_SOUTH} {_EAST},{_NORTH} {_WEST},{_NORTH} {_WEST},{_SOUTH} 0,0",
        "second": (
            f"start:{_EAST},10,-90 {_EAST},{_SOUTH} {_WEST},{_SOUTH} "
            f"{_WEST},{_NORTH} {_EAST},{_NORTH} {_EAST},10"
        ),
    },
    laps=2,
)
