"""A node's local grid: the cells its scan found empty and occupied, for RTAB-Map's tools."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from mapmyworld.types import Scan

_EMPTY, _OBSTACLE = 1, 2


def local_cells(
    scan: Scan, cell_size: float, reach: float
) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """Centres of the empty cells (1, N, 2) and of the occupied ones (1, M, 2) within `reach`.

    In m, base frame.
    """
    half = math.ceil(reach / cell_size) + 1
    grid = np.zeros((2 * half + 1, 2 * half + 1), np.uint8)
    away = (scan.points.astype(np.float64) - scan.origin[:2]) / cell_size
    cut = reach / cell_size / np.maximum(np.hypot(*away.T), 1e-9)
    _mark(grid, _along(away * np.minimum(cut, 1.0)[:, None]), _EMPTY)
    _mark(grid, away[cut >= 1.0], _OBSTACLE)
    # Centres on multiples of the cell, so that grids of all nodes compress and align alike.
    corner = np.rint(scan.origin[:2] / cell_size) - half
    centres = [
        ((np.argwhere(grid == kind)[:, ::-1] + corner) * cell_size).astype(np.float32)[None]
        for kind in (_EMPTY, _OBSTACLE)
    ]
    return centres[0], centres[1]


def _along(ends: NDArray[np.float64]) -> NDArray[np.float64]:
    """Places (K, 2) on the beams to `ends` (N, 2), in cells: one a cell of the longer axis."""
    lengths = np.abs(ends).max(axis=1, initial=1e-9)
    steps = np.arange(int(lengths.max(initial=0.0)))
    places = ends[:, None] * (steps / lengths[:, None])[..., None]
    return np.asarray(places[steps < np.floor(lengths)[:, None]])


def _mark(grid: NDArray[np.uint8], places: NDArray[np.float64], kind: int) -> None:
    """The cells of places (K, 2) about the grid's middle."""
    columns, rows = (places + grid.shape[0] / 2).astype(np.int64).T
    grid[rows, columns] = kind
