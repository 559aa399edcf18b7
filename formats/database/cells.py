"""A node's local grid: the cells its scan found empty and occupied, for RTAB-Map's tools."""

from __future__ import annotations

import math

import numpy as np
from numba import njit
from numpy.typing import NDArray

from mapmyworld.types import Scan

_EMPTY, _OBSTACLE = 1, 2


def _trace(points, x0, y0, cell, reach, grid):  # type: ignore[no-untyped-def]
    """Marks `grid`, centred on (x0, y0), along the beam to every point; ends win over rays."""
    half = grid.shape[0] // 2
    for k in range(points.shape[0]):
        dx, dy = points[k, 0] - x0, points[k, 1] - y0
        length = math.sqrt(dx * dx + dy * dy)
        if length < 1e-6:
            continue
        shown = min(length, reach)
        steps = int(shown / (0.5 * cell))
        for i in range(steps):
            t = i * 0.5 * cell / length
            row = half + math.floor(dy * t / cell + 0.5)
            col = half + math.floor(dx * t / cell + 0.5)
            if grid[row, col] == 0:
                grid[row, col] = 1
    for k in range(points.shape[0]):
        dx, dy = points[k, 0] - x0, points[k, 1] - y0
        if math.sqrt(dx * dx + dy * dy) <= reach:
            row = half + math.floor(dy / cell + 0.5)
            col = half + math.floor(dx / cell + 0.5)
            grid[row, col] = 2


_trace_beams = njit(
    "void(float32[:, ::1], float64, float64, float64, float64, uint8[:, ::1])",
    cache=True,
    nogil=True,
)(_trace)


def local_cells(
    scan: Scan, cell_size: float, reach: float
) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """Centres (1, N, 2) of the empty and of the occupied cells within `reach`, base frame."""
    half = math.ceil(reach / cell_size) + 1
    grid = np.zeros((2 * half + 1, 2 * half + 1), np.uint8)
    x0, y0 = float(scan.origin[0]), float(scan.origin[1])
    points = np.ascontiguousarray(scan.points, np.float32)
    _trace_beams(points, x0, y0, cell_size, reach, grid)
    # Centres on multiples of the cell, so that grids of all nodes compress and align alike.
    corner = np.rint(np.array([x0, y0]) / cell_size) - half
    empty, obstacle = (_centres(grid == kind, corner, cell_size) for kind in (_EMPTY, _OBSTACLE))
    return empty, obstacle


def _centres(
    mask: NDArray[np.bool_], corner: NDArray[np.float64], cell_size: float
) -> NDArray[np.float32]:
    rows, cols = np.nonzero(mask)
    centres = np.column_stack([cols + corner[0], rows + corner[1]]) * cell_size
    return centres.astype(np.float32)[None]
