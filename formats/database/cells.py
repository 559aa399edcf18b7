"""A node's local grid: the cells its scan found empty and occupied, for RTAB-Map's tools."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from formats.kernels import compiled
from mapmyworld.types import Scan

_EMPTY, _OBSTACLE = 1, 2


def _trace(points, x0, y0, cell, reach, grid):  # type: ignore[no-untyped-def]
    """Marks `grid`, centred on (x0, y0), along the beam to every point; ends win over rays."""
    centre = grid.shape[0] // 2 + 0.5
    for k in range(points.shape[0]):
        dx, dy = (points[k, 0] - x0) / cell, (points[k, 1] - y0) / cell
        length = math.sqrt(dx * dx + dy * dy)
        if length * cell > reach:
            dx, dy = dx * reach / (length * cell), dy * reach / (length * cell)
        # One step a cell of the longer axis (the digital differential analyser).
        steps = int(max(abs(dx), abs(dy)))
        if steps > 0:
            step_x, step_y = dx / max(abs(dx), abs(dy)), dy / max(abs(dx), abs(dy))
            x, y = centre, centre
            for _ in range(steps):
                grid[int(y), int(x)] = 1
                x, y = x + step_x, y + step_y
    for k in range(points.shape[0]):
        dx, dy = (points[k, 0] - x0) / cell, (points[k, 1] - y0) / cell
        if math.sqrt(dx * dx + dy * dy) * cell <= reach:
            grid[int(dy + centre), int(dx + centre)] = 2


_trace_beams = compiled(_trace)


def _list(grid, kind, x0, y0, cell, centres):  # type: ignore[no-untyped-def]
    """Fills `centres` with those of the cells of a kind, row by row; returns how many."""
    count = 0
    for row in range(grid.shape[0]):
        for col in range(grid.shape[1]):
            if grid[row, col] == kind:
                centres[count, 0] = (col + x0) * cell
                centres[count, 1] = (row + y0) * cell
                count += 1
    return count


_list_centres = compiled(_list)


def local_cells(
    scan: Scan, cell_size: float, reach: float
) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """Centres of the empty cells (1, N, 2) and of the occupied ones (1, M, 2) within `reach`.

    In m, base frame.
    """
    half = math.ceil(reach / cell_size) + 1
    grid = np.zeros((2 * half + 1, 2 * half + 1), np.uint8)
    x0, y0 = float(scan.origin[0]), float(scan.origin[1])
    points = np.ascontiguousarray(scan.points, np.float32)
    _trace_beams(points, x0, y0, cell_size, reach, grid)
    # Centres on multiples of the cell, so that grids of all nodes compress and align alike.
    corner = np.rint(np.array([x0, y0]) / cell_size) - half
    found = np.empty((grid.size, 2), np.float32)
    centres = []
    for kind in (_EMPTY, _OBSTACLE):
        count = _list_centres(grid, kind, corner[0], corner[1], cell_size, found)
        centres.append(found[None, :count].copy())
    return centres[0], centres[1]
