"""How well two occupancy grids agree, as they lie and after the best rigid alignment."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from mapmyworld.errors import MapError
from mapmyworld.evaluation.grid_alignment import align_cells
from mapmyworld.geometry.planar import invert_planar, transform_points_planar
from mapmyworld.types import OccupancyGrid

_ROUNDING = 1e-6  # cells
Points = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class GridAgreement:
    """Shares from 0 to 1. Distances are counted in cells of the reference, diagonals as one."""

    precision_1: float
    """Of the occupied cells, how many lie within one cell of a truly occupied one."""
    recall_1: float
    """Of the truly occupied cells, how many have an occupied one within one cell."""
    precision_2: float
    recall_2: float
    free: float
    """Of the truly free cells, how many are free."""

    @property
    def f1(self) -> float:
        """Harmonic mean of precision and recall within one cell."""
        total = self.precision_1 + self.recall_1
        return 2.0 * self.precision_1 * self.recall_1 / total if total > 0.0 else 0.0


@dataclass(frozen=True, slots=True, eq=False)
class GridScore:
    """How well a grid agrees with a reference, as it lies and best aligned."""

    unaligned: GridAgreement
    aligned: GridAgreement
    reference_from_grid: NDArray[np.float64]
    """(3,) x, y, yaw of the best alignment."""
    unknown: float
    """Share of the cells that the reference knows and the grid does not, after alignment."""


def grid_score(grid: OccupancyGrid, reference: OccupancyGrid) -> GridScore:
    """Agreement of a grid with the true one; raises `MapError` where either has no wall."""
    occupied, true = occupied_centres(grid), occupied_centres(reference)
    for points, name in ((occupied, "the grid"), (true, "the reference")):
        if len(points) == 0:
            raise MapError(f"{name} has no occupied cell: there is nothing to compare")
    still, motion = np.zeros(3), align_cells(occupied, true)
    unaligned = _agreement(grid, reference, occupied, true, still)
    aligned = _agreement(grid, reference, occupied, true, motion)
    if unaligned.f1 >= aligned.f1:
        motion, aligned = still, unaligned
    unknown = float((_values_at(grid, reference, motion) < 0).mean())
    return GridScore(unaligned, aligned, motion, unknown)


def occupied_centres(grid: OccupancyGrid) -> Points:
    """Centres (N, 2) in metres of the occupied cells."""
    row, column = np.nonzero(grid.trinary() == 100)
    return grid.origin + (np.stack([column, row], axis=1) + 0.5) * grid.resolution


def _agreement(
    grid: OccupancyGrid,
    reference: OccupancyGrid,
    occupied: Points,
    true: Points,
    reference_from_grid: NDArray[np.float64],
) -> GridAgreement:
    moved = transform_points_planar(reference_from_grid, occupied)
    found = cKDTree(true).query(moved, p=np.inf)[0] / reference.resolution
    missed = cKDTree(moved).query(true, p=np.inf)[0] / reference.resolution
    known = reference.trinary()
    values = _values_at(grid, reference, reference_from_grid)
    free = known[known >= 0] == 0
    return GridAgreement(
        precision_1=float((found <= 1.0 + _ROUNDING).mean()),
        recall_1=float((missed <= 1.0 + _ROUNDING).mean()),
        precision_2=float((found <= 2.0 + _ROUNDING).mean()),
        recall_2=float((missed <= 2.0 + _ROUNDING).mean()),
        free=float((values[free] == 0).mean()) if free.any() else 1.0,
    )


def _values_at(
    grid: OccupancyGrid, reference: OccupancyGrid, reference_from_grid: NDArray[np.float64]
) -> NDArray[np.int8]:
    """The grid's trinary values at the centres of the cells that the reference knows."""
    row, column = np.nonzero(reference.trinary() >= 0)
    centres = reference.origin + (np.stack([column, row], axis=1) + 0.5) * reference.resolution
    place = transform_points_planar(invert_planar(reference_from_grid), centres)
    index = np.floor((place - grid.origin) / grid.resolution).astype(np.int64)
    height, width = grid.log_odds.shape
    inside = (index >= 0).all(1) & (index[:, 0] < width) & (index[:, 1] < height)
    values = np.full(len(index), -1, np.int8)
    values[inside] = grid.trinary()[index[inside, 1], index[inside, 0]]
    return values
