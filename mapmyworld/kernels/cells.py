"""Points and the cells that they lie in: one point to a cell, and what a grid has there."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from mapmyworld.kernels.branch_and_bound import RESOLUTION, SQUARE, UNSEEN
from mapmyworld.kernels.compiling import jit


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
def evidence_at(
    cells: NDArray[np.uint8], corner: NDArray[np.float64], points: NDArray[np.float64],
    pose: NDArray[np.float64],
) -> NDArray[np.int64]:  # fmt: skip
    """(N,) what a grid of evidence indicates of points (N, 2) at `pose` (3,): more than nothing
    where it has a surface, less where beams passed, 0 where it was not seen.

    Its `cells` (H, W) are those of a `LikelihoodGrid`, the first one that is not padding at
    `corner` (2,).
    """
    height, width = cells.shape
    cosine, sine = np.cos(pose[2]), np.sin(pose[2])
    found = np.zeros(len(points), np.int64)
    for n in range(len(points)):
        x = pose[0] + cosine * points[n, 0] - sine * points[n, 1]
        y = pose[1] + sine * points[n, 0] + cosine * points[n, 1]
        column = int(np.floor((x - corner[0]) / RESOLUTION)) + SQUARE
        row = int(np.floor((y - corner[1]) / RESOLUTION)) + SQUARE
        if 0 <= column < width and 0 <= row < height:
            found[n] = int(cells[row, column]) - UNSEEN
    return found
