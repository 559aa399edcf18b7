"""Points and the cells that they lie in: one point to a cell, and what a grid has there."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from mapmyworld.kernels.branch_and_bound import RESOLUTION, SQUARE, UNSEEN
from mapmyworld.kernels.compiling import inner_jit, jit

_BEFORE = 3
"""Cells that reach from a surface past those beside it."""


@jit
def first_in_cells(points: NDArray[np.float64], edge: float) -> NDArray[np.int64]:
    """(K,) the first of points (N, 2) in each cell with this edge, ascending."""
    count, room = len(points), 16
    while room < 2 * count:
        room *= 2
    cells, table = np.empty((count, 2), np.int64), np.full(room, -1)
    found, kept = np.empty(count, np.int64), 0
    for n in range(count):
        x, y = int(np.floor(points[n, 0] / edge)), int(np.floor(points[n, 1] / edge))
        cells[n, 0], cells[n, 1] = x, y
        slot = (x * 73856093 ^ y * 19349663) & (room - 1)
        while table[slot] >= 0 and (cells[table[slot], 0] != x or cells[table[slot], 1] != y):
            slot = (slot + 1) & (room - 1)
        if table[slot] < 0:
            table[slot], found[kept] = n, n
            kept += 1
    return found[:kept]


@jit
def judged(
    points: NDArray[np.float64], own: NDArray[np.uint8], own_corner: NDArray[np.float64],
    other: NDArray[np.uint8], corner: NDArray[np.float64], pose: NDArray[np.float64],
) -> NDArray[np.int64]:  # fmt: skip
    """(N,) what the `other` grid of evidence (H, W) indicates of points (N, 2) at `pose` (3,): 1
    where it has a surface, -1 where its beams passed, 0 where it was not seen, or from the other
    side alone.

    The first cell of a `LikelihoodGrid` that is not padding is at its corner, (2,). The points are
    of their `own` grid (I, J), in its frame, whose corner `own_corner` (2,) is. A surface has two
    sides where beams of both grids passed in the `_BEFORE` cells around it, but none through the
    same ones.
    """
    cosine, sine = np.cos(pose[2]), np.sin(pose[2])
    found = np.zeros(len(points), np.int64)
    for n in range(len(points)):
        x = pose[0] + cosine * points[n, 0] - sine * points[n, 1]
        y = pose[1] + sine * points[n, 0] + cosine * points[n, 1]
        there = _evidence(other, corner, x, y)
        found[n] = 1 if there > 0 else -1 if there < 0 else 0
        if there <= 0:
            continue
        ours = theirs = shared = False
        for k in range((2 * _BEFORE + 1) ** 2):
            dx = RESOLUTION * (k // (2 * _BEFORE + 1) - _BEFORE)
            dy = RESOLUTION * (k % (2 * _BEFORE + 1) - _BEFORE)
            here = _evidence(own, own_corner, points[n, 0] + dx, points[n, 1] + dy) < 0
            there = _evidence(
                other, corner, x + cosine * dx - sine * dy, y + sine * dx + cosine * dy
            )
            ours, theirs = ours or here, theirs or there < 0
            if here and there < 0:
                shared = True
                break
        if ours and theirs and not shared:
            found[n] = 0
    return found


@inner_jit
def _evidence(cells: NDArray[np.uint8], corner: NDArray[np.float64], x: float, y: float) -> int:
    """More than 0 where a grid has a surface, less where beams passed, 0 where it was not seen."""
    height, width = cells.shape
    column = int(np.floor((x - corner[0]) / RESOLUTION)) + SQUARE
    row = int(np.floor((y - corner[1]) / RESOLUTION)) + SQUARE
    inside = 0 <= column < width and 0 <= row < height
    return int(cells[row, column]) - UNSEEN if inside else 0
