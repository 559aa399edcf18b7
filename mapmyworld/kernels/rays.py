"""What rays pass through in a grid: scans counted in every cell, or free cells cleared."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from mapmyworld.kernels.compiling import inner_jit, jit

Ray = tuple[int, int, int, int, float, float, float, float, int]


@jit
def count_scans(
    counts: NDArray[np.uint16],
    marks: NDArray[np.uint8],
    starts: NDArray[np.float64],
    ends: NDArray[np.float64],
    is_hit: NDArray[np.bool_],
    bounds: NDArray[np.int64],
) -> None:
    """At most 255 scans from `starts` (S, 2) to their `ends[bounds[s]:bounds[s + 1]]`.

    All in cells; each cell counts once a scan, hits first. `ends` (N, 2), `bounds` (S + 1,) and
    `is_hit` (N,), where a ray ended on a surface. `counts` (H, W, 2) are the hits and the passes of
    a grid; its `marks` (H, W) are zeros and remember the last scan that a cell counted. A ray
    visits every cell it touches (Amanatides and Woo, 1987) and stops before the one it ends in. All
    coordinates must lie inside the grid.
    """
    for s in range(len(starts)):
        mark = s + 1
        for k in range(bounds[s], bounds[s + 1]):
            if is_hit[k]:
                row, column = int(ends[k, 1]), int(ends[k, 0])
                if marks[row, column] != mark:
                    marks[row, column] = mark
                    if counts[row, column, 0] < 65535:
                        counts[row, column, 0] += 1
        for k in range(bounds[s], bounds[s + 1]):
            _pass_through(counts, marks, mark, starts[s, 0], starts[s, 1], ends[k, 0], ends[k, 1])


@jit
def clear_passed(
    cells: NDArray[np.uint8],
    starts: NDArray[np.float64],
    ends: NDArray[np.float64],
    bounds: NDArray[np.int64],
) -> None:
    """Sets to 0 all `cells` (H, W) that rays pass through.

    Rays lead from `starts` (S, 2) to `ends` (N, 2), `bounds` (S + 1,), as those of `count_scans`.
    """
    for s in range(len(starts)):
        for k in range(bounds[s], bounds[s + 1]):
            ray = ray_of(starts[s, 0], starts[s, 1], ends[k, 0], ends[k, 1])
            while ray[8] > 0:
                cells[ray[1], ray[0]] = 0
                ray = onward(ray)


@inner_jit
def _pass_through(
    counts: NDArray[np.uint16],
    marks: NDArray[np.uint8],
    mark: int,
    x0: float,
    y0: float,
    x1: float,
    y1: float,
) -> None:
    ray = ray_of(x0, y0, x1, y1)
    while ray[8] > 0:
        column, row = ray[0], ray[1]
        if marks[row, column] != mark:
            marks[row, column] = mark
            if counts[row, column, 1] < 65535:
                counts[row, column, 1] += 1
        ray = onward(ray)


@inner_jit
def ray_of(x0: float, y0: float, x1: float, y1: float) -> Ray:
    """Where a ray is: its cell (column and row), the steps to the next ones, the share of it at
    which it next crosses a vertical and a horizontal line of the lattice, and by how much these
    grow; and how many cells it still passes. Here in its first cell.
    """
    column, row = math.floor(x0), math.floor(y0)
    dx, dy = x1 - x0, y1 - y0
    step_x = 1 if dx > 0 else -1
    step_y = 1 if dy > 0 else -1
    next_x = math.inf if dx == 0 else ((column + (step_x > 0)) - x0) / dx
    next_y = math.inf if dy == 0 else ((row + (step_y > 0)) - y0) / dy
    grow_x = math.inf if dx == 0 else step_x / dx
    grow_y = math.inf if dy == 0 else step_y / dy
    left = abs(math.floor(x1) - column) + abs(math.floor(y1) - row)
    return column, row, step_x, step_y, next_x, next_y, grow_x, grow_y, left


@inner_jit
def onward(ray: Ray) -> Ray:
    """The ray in its next cell."""
    column, row, step_x, step_y, next_x, next_y, grow_x, grow_y, left = ray
    if next_x < next_y:
        column, next_x = column + step_x, next_x + grow_x
    else:
        row, next_y = row + step_y, next_y + grow_y
    return column, row, step_x, step_y, next_x, next_y, grow_x, grow_y, left - 1
