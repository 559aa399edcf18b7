"""Buildings drawn at random: corridors at right angles around courtyards, and what is in them.

Corridors 40 to 250 m long meet on a lattice. From them open rooms, and alcoves of closed doors at
equal distances; pillars and clutter stand along their walls. Bare ones are long, and show little.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Box = tuple[float, float, float, float]
Junction = tuple[int, int]
_BARE = {"open": 0.02, "blank": 0.9, "deep": 0.05, "clutter": 0.003, "pillars": 0.0}


@dataclass(frozen=True)
class Building:
    """Free space as boxes, things that stand in it, and the middle lines of its corridors."""

    free: list[Box]
    things: list[Box]
    lines: tuple[list[float], list[float]]
    corridors: set[tuple[Junction, Junction]]
    rooms: dict[tuple[Junction, Junction], list[tuple[Array, Array, Array]]]


def draw_building(random: np.random.Generator, *, bare: bool = False) -> Building:
    """Corridors on a lattice, rooms behind some of their doors; or long and `bare` ones."""
    size = random.uniform([40.0, 30.0], [250.0, 180.0]) ** random.choice([0.9, 1.0])
    lines = lattice(random, size[0], bare=bare), lattice(random, size[1], bare=bare)
    shape = (len(lines[0]), len(lines[1]))
    corridors = drawn_corridors(random, shape)
    width = random.uniform(1.8, 3.4)
    free: list[Box] = []
    things: list[Box] = []
    rooms: dict[tuple[Junction, Junction], list[tuple[Array, Array, Array]]] = {}
    style = {
        "pitch": random.uniform(3.0, 7.0),
        "open": random.choice([0.03, 0.15, 0.35]),
        "blank": random.choice([0.1, 0.5]),
        "deep": random.choice([0.05, 0.12, 0.25]),
        "clutter": random.choice([0.005, 0.05, 0.15]),
        "pillars": random.choice([0.0, 0.0, 6.0]),
        "width": width,
    } | (_BARE if bare else {})
    for corridor in sorted(corridors):
        ends = np.array([[lines[0][i], lines[1][j]] for i, j in corridor])
        furnish(random, ends, style, free, things, rooms.setdefault(corridor, []))
    return Building(free, things, lines, corridors, rooms)


def lattice(random: np.random.Generator, length: float, *, bare: bool) -> list[float]:
    """Where corridors run across a building of this length."""
    low, high, most, rest = (60.0, 200.0, 4, 30.0) if bare else (12.0, 60.0, 6, 12.0)
    gaps = [random.uniform(low, high)]
    while sum(gaps) < length - rest and len(gaps) < most:
        gaps.append(random.uniform(low, high))
    scale = length / sum(gaps)
    return [0.0, *np.cumsum(np.array(gaps) * scale).tolist()]


def drawn_corridors(
    random: np.random.Generator, shape: tuple[int, int]
) -> set[tuple[Junction, Junction]]:
    """The outermost ones, and of the others two in three, none of which ends blind."""
    kept = set()
    for i in range(shape[0]):
        for j in range(shape[1]):
            for other in ((i + 1, j), (i, j + 1)):
                if other[0] < shape[0] and other[1] < shape[1]:
                    outer = (i == other[0] and i in (0, shape[0] - 1)) or (
                        j == other[1] and j in (0, shape[1] - 1)
                    )
                    if outer or random.random() < 0.67:
                        kept.add(((i, j), other))
    while True:
        degree: dict[Junction, int] = {}
        for ends in kept:
            for end in ends:
                degree[end] = degree.get(end, 0) + 1
        blind = {ends for ends in kept if min(degree[end] for end in ends) < 2}
        if not blind:
            return kept
        kept -= blind


def furnish(
    random: np.random.Generator, ends: Array, style: dict[str, float], free: list[Box],
    things: list[Box], rooms: list[tuple[Array, Array, Array]],
) -> None:  # fmt: skip
    """A corridor with what opens from it and what stands in it."""
    start, end = ends
    length = float(np.abs(end - start).sum())
    along = (end - start) / length
    half = style["width"] / 2.0

    def box(s0: float, s1: float, d0: float, d1: float, side: float) -> Box:
        across = side * np.array([-along[1], along[0]])
        a, b = start + along * s0 + across * d0, start + along * s1 + across * d1
        low, high = np.minimum(a, b), np.maximum(a, b)
        return float(low[0]), float(low[1]), float(high[0]), float(high[1])

    free.append(box(-half, length + half, -half, half, 1.0))
    for side in (-1.0, 1.0):
        middle = half + style["pitch"] * random.uniform(0.5, 1.0)
        while middle < length - half - 1.0:
            kind = random.random()
            if kind < style["open"]:
                depth, wide = random.uniform(2.5, 5.0), 0.45 * style["pitch"]
                free.append(box(middle - 0.7, middle + 0.7, half - 0.01, half + 0.16, side))
                free.append(box(middle - wide, middle + wide, half + 0.15, half + depth, side))
                for _ in range(random.integers(0, 4)):
                    s, d = middle + random.uniform(-wide, wide), half + random.uniform(1.2, depth)
                    if abs(s - middle) > 0.8:
                        things.append(box(s, s + random.uniform(0.2, 1.2), d, d + 0.5, side))
                across = side * np.array([-along[1], along[0]])
                door = start + along * middle
                rooms.append((door, door + across * (half + 1.2), along * middle))
            elif kind > style["open"] + style["blank"] * (1.0 - style["open"]):
                free.append(
                    box(middle - 0.45, middle + 0.45, half - 0.01, half + style["deep"], side)
                )
            middle += style["pitch"]
        for _ in range(random.poisson(style["clutter"] * length)):
            s = random.uniform(half, length - half)
            wide, deep = random.uniform(0.2, 1.5), random.uniform(0.15, max(0.2, half - 0.6))
            things.append(box(s, s + wide, half - min(deep, half - 0.55), half + 0.01, side))
        if style["pillars"]:
            every = np.arange(half + 2.0, length - half, style["pillars"])
            things += [box(s, s + 0.3, half - 0.2, half + 0.01, side) for s in every]


def walls(building: Building) -> Array:
    """(S, 4) what a laser meets: the outline of the free space and of the things in it."""
    found = [part for box in building.free for part in sides(box, building.free)]
    found += [part for box in building.things for part in sides(box, [])]
    return np.array(found)


def sides(box: Box, others: list[Box]) -> list[Box]:
    """The sides of a box, without what lies inside others."""
    x0, y0, x1, y1 = box
    found: list[Box] = []
    for x in (x0, x1):
        holes = [(b, d) for a, b, c, d in others if a + 1e-6 < x < c - 1e-6]
        found += [(x, a, x, b) for a, b in left_over(y0, y1, holes)]
    for y in (y0, y1):
        holes = [(a, c) for a, b, c, d in others if b + 1e-6 < y < d - 1e-6]
        found += [(a, y, b, y) for a, b in left_over(x0, x1, holes)]
    return found


def left_over(
    low: float, high: float, holes: list[tuple[float, float]]
) -> list[tuple[float, float]]:
    """What remains of an interval."""
    parts = []
    for a, b in sorted(holes):
        if a > low:
            parts.append((low, min(a, high)))
        low = max(low, b)
        if low >= high:
            return parts
    return [*parts, (low, high)]
