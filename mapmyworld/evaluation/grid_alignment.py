"""The rigid motion that lays the walls of one grid on those of another."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray
from scipy.fft import irfft2, rfft2
from scipy.spatial import cKDTree

from mapmyworld.geometry.planar import transform_points_planar, wrap_angle

_COARSE = 0.2  # m, cell of the search over all rotations and shifts
_TURNS = 180  # rotations tried, over the full circle
_CANDIDATES = 4  # best rotations that are compared
_MOST_CELLS = 512  # along an edge of the coarse picture; larger maps get larger cells
_NEAR = 0.05  # m of distance that halves, roughly, how well a wall fits another
_LAST_STEP = 0.002  # m of the search by steps


def align_cells(points: NDArray[np.float64], reference: NDArray[np.float64]) -> NDArray[np.float64]:
    """`reference_from_points` (3,) that lays points (N, 2) best on those of the reference (M, 2).

    All in metres. As they lie, or by the rotation and shift of a search by correlation that fit
    best; then moved by ever smaller steps as long as walls come nearer to walls.
    """
    tree, size = cKDTree(reference), float(np.hypot(*np.ptp(points, axis=0)))

    def fit(motion: NDArray[np.float64]) -> float:
        return _fit(points, reference, tree, motion)

    starts = [np.zeros(3), *_correlated(points, reference)]
    motion = _climbed(max(starts, key=fit), fit, size)
    return np.append(motion[:2], wrap_angle(motion[2]))


def _fit(
    points: NDArray[np.float64],
    reference: NDArray[np.float64],
    tree: cKDTree,
    motion: NDArray[np.float64],
) -> float:
    """How near walls lie to walls, 0 to 2; both ways, so that a small map is not hidden in a
    corner of a large one.
    """
    moved = transform_points_planar(motion, points)
    there = tree.query(moved)[0] / _NEAR
    back = cKDTree(moved).query(reference)[0] / _NEAR
    return float(np.exp(-0.5 * there**2).mean() + np.exp(-0.5 * back**2).mean())


def _climbed(
    motion: NDArray[np.float64], fit: Callable[[NDArray[np.float64]], float], size: float
) -> NDArray[np.float64]:
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


def _correlated(
    points: NDArray[np.float64], reference: NDArray[np.float64]
) -> list[NDArray[np.float64]]:
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


def _picture(points: NDArray[np.float64], cell: float, edge: int) -> NDArray[np.float64]:
    """A square picture with the centre of the points in its middle; 1 where there is a wall."""
    picture = np.zeros((edge, edge))
    index = np.floor(points / cell).astype(np.int64) + edge // 2
    inside = ((index >= 0) & (index < edge)).all(axis=1)
    picture[index[inside, 1], index[inside, 0]] = 1.0
    return picture
