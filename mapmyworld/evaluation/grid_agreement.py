"""How well two occupancy grids agree, as they lie and after the best rigid alignment."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.fft import irfft2, rfft2
from scipy.spatial import cKDTree

from mapmyworld.errors import MapError
from mapmyworld.geometry import Array
from mapmyworld.geometry.planar import invert_planar, transform_points_planar, wrap_angle
from mapmyworld.types import OccupancyGrid

_ROUNDING = 1e-6  # cells
_COARSE = 0.2  # m, cell of the search over all rotations and shifts
_TURNS = 180  # rotations tried, over the full circle
_CANDIDATES = 4  # best rotations that are compared
_MOST_CELLS = 512  # along an edge of the coarse picture; larger maps get larger cells
_NEAR = 0.05  # m of distance that halves, roughly, how well a wall fits another
_LAST_STEP = 0.002  # m of the search by steps


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
    reference_from_grid: Array
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


def occupied_centres(grid: OccupancyGrid) -> Array:
    """Centres (N, 2) in metres of the occupied cells."""
    row, column = np.nonzero(grid.trinary() == 100)
    return grid.origin + (np.stack([column, row], axis=1) + 0.5) * grid.resolution


def _agreement(
    grid: OccupancyGrid,
    reference: OccupancyGrid,
    occupied: Array,
    true: Array,
    reference_from_grid: Array,
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
    grid: OccupancyGrid, reference: OccupancyGrid, reference_from_grid: Array
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


def align_cells(points: Array, reference: Array) -> Array:
    """`reference_from_points` (3,) that lays points (N, 2) best on those of the reference (M, 2).

    All in metres. As they lie, or by the rotation and shift of a search by correlation that fit
    best; then moved by ever smaller steps as long as walls come nearer to walls.
    """
    tree, size = cKDTree(reference), float(np.hypot(*np.ptp(points, axis=0)))

    def fit(motion: Array) -> float:
        return _fit(points, reference, tree, motion)

    starts = [np.zeros(3), *_correlated(points, reference)]
    motion = _climbed(max(starts, key=fit), fit, size)
    return np.append(motion[:2], wrap_angle(motion[2]))


def _fit(points: Array, reference: Array, tree: cKDTree, motion: Array) -> float:
    """How near walls lie to walls, 0 to 2; both ways, so that a small map is not hidden in a
    corner of a large one.
    """
    moved = transform_points_planar(motion, points)
    there = tree.query(moved)[0] / _NEAR
    back = cKDTree(moved).query(reference)[0] / _NEAR
    return float(np.exp(-0.5 * there**2).mean() + np.exp(-0.5 * back**2).mean())


def _climbed(motion: Array, fit: Callable[[Array], float], size: float) -> Array:
    """The motion after steps along each direction as long as they help."""
    best, step = fit(motion), _COARSE
    while step >= _LAST_STEP:
        moves = np.diag([step, step, 2.0 * step / max(size, 1.0)])
        tried = [motion + sign * move for move in moves for sign in (1.0, -1.0)]
        values = [fit(candidate) for candidate in tried]
        if max(values) > best:
            best, motion = max(values), tried[int(np.argmax(values))]
        else:
            step /= 2.0
    return motion


def _correlated(points: Array, reference: Array) -> list[Array]:
    """Rotations and shifts at which coarse pictures of both overlap most, best first."""
    middle, target = points.mean(0), reference.mean(0)
    radius = max(np.abs(points - middle).max(), np.abs(reference - target).max()) * np.sqrt(2.0)
    cell = max(_COARSE, 4.0 * radius / _MOST_CELLS)
    edge = int(2 ** np.ceil(np.log2(4.0 * radius / cell + 4.0)))
    spectrum = rfft2(_picture(reference - target, cell, edge))
    found = []
    for yaw in 2.0 * np.pi * np.arange(_TURNS) / _TURNS:
        turned = transform_points_planar(np.array([0.0, 0.0, yaw]), points - middle)
        overlap = irfft2(spectrum * np.conj(rfft2(_picture(turned, cell, edge))), (edge, edge))
        best = int(overlap.argmax())
        row, column = divmod(best, edge)
        shift = np.array([column, row], np.float64)
        shift = np.where(shift > edge / 2, shift - edge, shift) * cell
        # A point goes to R (p - middle) + shift + target.
        turned_middle = transform_points_planar(np.array([0.0, 0.0, yaw]), middle[None])[0]
        x, y = shift + target - turned_middle
        found.append((float(overlap.flat[best]), np.array([x, y, yaw])))
    found.sort(key=lambda item: -item[0])
    return [motion for _, motion in found[:_CANDIDATES]]


def _picture(points: Array, cell: float, edge: int) -> Array:
    """A square picture with the centre of the points in its middle; 1 where there is a wall."""
    picture = np.zeros((edge, edge))
    index = np.floor(points / cell).astype(np.int64) + edge // 2
    inside = ((index >= 0) & (index < edge)).all(axis=1)
    picture[index[inside, 1], index[inside, 0]] = 1.0
    return picture
