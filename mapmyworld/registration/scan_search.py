"""A scan looked for in a submap, however poor the guess: exhaustive, by branch and bound."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mapmyworld.kernels.branch_and_bound import FULL, best_shift, fill_pyramid
from mapmyworld.registration.scan_matching import PreparedScan, ScanSet

Array = NDArray[np.float64]
Window = tuple[NDArray[np.uint8], int, Array, Array, float, Array, int, Array]
"""What `best_shift` is given of grid, points and window."""
_RESOLUTION = 0.1  # m, cells of the likelihood grid
_LEVELS = 6  # of the pyramid: the coarsest bounds 3.2 m x 3.2 m of shifts
_NEAR = 0.6  # likelihood of a point one cell beside a surface
_POINTS = 140  # of the scan that are scored
_ELSEWHERE = np.array([0.6, 0.3])  # m and rad from the best pose where a rival counts
_NOWHERE = np.array([0.0, 0.0, 0.0, -1.0, -1.0])


@dataclass(frozen=True, slots=True, eq=False)
class LikelihoodGrid:
    """How likely a surface is, cell by cell, and its maxima over ever larger squares."""

    pyramid: NDArray[np.uint8]
    """(levels, H, W), 255 where there is one."""
    corner: Array
    """(2,) of the first unpadded cell, in the frame of the points."""
    margin: int
    resolution: float

    def likelihoods(self, level: int) -> NDArray[np.float32]:
        """(H, W) of a level, 0 to 1."""
        return np.asarray(self.pyramid[level] * np.float32(1.0 / FULL), np.float32)


@dataclass(frozen=True, slots=True, eq=False)
class Found:
    """The best pose in the window and its rival."""

    pose: Array
    """(3,)."""
    score: float
    """Mean likelihood of the scan's points, 0 to 1."""
    rival: float
    """Score of the best pose elsewhere in the window; 0 if none comes near."""


def likelihood_grid(points: Array) -> LikelihoodGrid:
    """The grid of surface points (N, 2); of none, where a blind laser saw nothing."""
    margin = 1 << (_LEVELS - 1)
    corner = points.min(axis=0, initial=np.inf if len(points) else 0.0) - 2.0 * _RESOLUTION
    cells = np.floor((points - corner) / _RESOLUTION).astype(np.int64) + margin
    width, height = cells.max(axis=0, initial=margin) + 3 + margin
    pyramid = np.zeros((_LEVELS, height, width), np.uint8)
    pyramid[0, cells[:, 1], cells[:, 0]] = FULL
    fill_pyramid(pyramid, round(_NEAR * FULL))
    return LikelihoodGrid(pyramid, corner, margin, _RESOLUTION)


def search_grid(
    points: Array, grid: LikelihoodGrid, guess: Array, distance: float, angle: float, least: float
) -> Found | None:
    """The best pose of points (N, 2) in a window about `guess`; None if none exceeds `least`."""
    if len(points) == 0:
        return None
    fixed = _window(points, grid, guess, distance, angle)
    best = np.zeros(4)
    best_shift(*fixed, least, _NOWHERE, best)
    if best[0] <= least:
        return None
    rival = _best_elsewhere(fixed, best[1:], max(least, 0.8 * best[0]))[0]
    return Found(best[1:].copy(), float(best[0]), float(rival))


def score_elsewhere(
    points: Array, grid: LikelihoodGrid, pose: Array, distance: float, angle: float, least: float
) -> float:
    """The best score in a window about `pose` but not at it; 0 if none exceeds `least`."""
    return float(_best_elsewhere(_window(points, grid, pose, distance, angle), pose, least)[0])


def pose_elsewhere(
    points: Array, grid: LikelihoodGrid, guess: Array, distance: float, angle: float,
    least: float, pose: Array,
) -> Array | None:  # fmt: skip
    """The best pose (3,) in a window about `guess` but not at `pose`, if one exceeds `least`."""
    best = _best_elsewhere(_window(points, grid, guess, distance, angle), pose, least)
    return best[1:] if best[0] > 0.0 else None


def _window(
    points: Array, grid: LikelihoodGrid, guess: Array, distance: float, angle: float
) -> Window:
    """The window about a guess in which the points are looked for."""
    used = _spread(points, grid.resolution)
    far = float(np.percentile(np.hypot(*used.T), 80))
    step = float(np.clip(grid.resolution / max(far, 1.0), 0.01, 0.05))
    count = int(np.ceil(angle / step))
    angles = np.arange(-count, count + 1, dtype=np.float64) * step
    reach = int(np.ceil(distance / grid.resolution))
    return grid.pyramid, grid.margin, used, grid.corner, grid.resolution, guess, reach, angles


def _best_elsewhere(window: Window, pose: Array, least: float) -> Array:
    """(4,) score and pose; zeros if no score exceeds `least`."""
    best = np.zeros(4)
    best_shift(*window, least, np.concatenate([pose, _ELSEWHERE]), best)
    return best if best[0] > least else np.zeros(4)


def _spread(points: Array, spacing: float) -> Array:
    """Points one to a cell, so that what was seen twice does not count twice; not too many."""
    x, y = np.floor(points / spacing).astype(np.int64).T
    first = np.sort(np.unique((x << 32) + y, return_index=True)[1])
    few = first[np.linspace(0, len(first) - 1, min(_POINTS, len(first))).astype(np.int64)]
    return np.ascontiguousarray(points[few], np.float64)


def search_pose(
    scan: PreparedScan, targets: ScanSet, poses: Array, guess: Array, distance: float, angle: float
) -> Found | None:
    """Where a scan lies among targets at `poses` (S, 3), within a window about `guess`."""
    points = submap_points(targets, np.arange(len(targets)), poses)
    if len(points) == 0:
        return None
    return search_grid(scan.rows[:, :2].astype(np.float64), likelihood_grid(points), guess,
                        distance, angle, 0.3)  # fmt: skip


def submap_points(scans: ScanSet, which: NDArray[np.int64], poses: Array) -> Array:
    """All points (N, 2) of scans `which` at their `poses` (len(which), 3)."""
    if len(which) == 0:
        return np.zeros((0, 2))
    rows, of = rows_of(scans, which)
    c, s = np.cos(poses[:, 2])[of], np.sin(poses[:, 2])[of]
    x, y = rows[:, 0].astype(np.float64), rows[:, 1].astype(np.float64)
    return np.stack([poses[of, 0] + c * x - s * y, poses[of, 1] + s * x + c * y], axis=-1)


def rows_of(
    scans: ScanSet, which: NDArray[np.int64], step: int = 1
) -> tuple[NDArray[np.float32], NDArray[np.int64]]:
    """Every `step`-th row (N, 5) of scans `which`, and the place in `which` (N,) of its scan."""
    parts = [scans.rows[scans.bounds[w] : scans.bounds[w + 1] : step] for w in which]
    return np.concatenate(parts), np.repeat(np.arange(len(which)), [len(part) for part in parts])
