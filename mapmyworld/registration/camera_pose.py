"""The pose of a camera from 3D points and what it sees of them, robustly."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from mapmyworld.geometry import Array
from mapmyworld.geometry.rigid import invert, make_transform, se3_exp
from mapmyworld.geometry.rotations import so3_exp
from mapmyworld.kernels.pose_refinement import pose_normal_equations
from mapmyworld.types.rows import CountedRows

LEAST_SHARE = 0.25
"""Of the sightings that agree where a pose is right."""
_BEHIND = 1e12  # squared error of a point behind the camera
_MISS = 1e-4  # probability of having overlooked the best hypothesis at which the search ends


@dataclass(frozen=True, slots=True, eq=False)
class Sightings(CountedRows):
    """What one camera saw of N known points, in normalised image coordinates."""

    points: Array
    """(N, 3) metres, map frame."""
    seen: Array
    """(N, 3): x, y at depth 1 and the inverse depth in 1/m, NaN without depth."""
    sigmas: Array
    """(N, 3) standard deviations of x and y, and of the inverse depth; and the largest deviation of
    the inverse depth that is no outlier, since depth is wrong by far more than noise at edges."""


def errors(pose: Array, sightings: Sightings) -> Array:
    """Squared residuals (N, 2) in sigmas: image position, inverse depth (0 without depth).

    From map_from_camera (4, 4).
    """
    local = (sightings.points - pose[:3, 3]) @ pose[:3, :3]
    before = local[:, 2] > 1e-3
    inverse = 1.0 / np.where(before, local[:, 2], 1.0)
    away = (local[:, :2] * inverse[:, None] - sightings.seen[:, :2]) / sightings.sigmas[:, :1]
    deeper = (inverse - sightings.seen[:, 2]) / sightings.sigmas[:, 1]
    squared = np.stack([(away**2).sum(axis=1), np.nan_to_num(deeper) ** 2], axis=1)
    return np.where(before[:, None], squared, _BEHIND)


def inliers(pose: Array, sightings: Sightings, limit: float) -> NDArray[np.bool_]:
    """Mask (N,) of sightings within `limit` sigmas of map_from_camera (4, 4), whose depth fits."""
    squared = errors(pose, sightings)
    deviation = np.sqrt(squared[:, 1]) * sightings.sigmas[:, 1]
    return np.asarray((squared[:, 0] < limit * limit) & (deviation < sightings.sigmas[:, 2]))


def ransac_pose(sightings: Sightings, limit: float, least: int = 1) -> tuple[Array, int]:
    """The map_from_camera (4, 4) on which most sightings agree within `limit` sigmas; how many.

    By rays alone (P3P), refined on what agrees with it, depth and all, as four noisy points fit few
    others. Fewer than `least` agreeing sightings, or than `LEAST_SHARE` of all, are of no use: the
    search ends once more would hardly have been overlooked. Where nothing fits, it is the identity
    and 0. (Chum, Matas and Kittler, "Locally optimized RANSAC", 2003.)
    """
    if len(sightings) < max(least, 4):
        return np.eye(4), 0
    reach = limit * float(np.median(sightings.sigmas[:, 0]))
    rounds = _rounds_needed(max(least / len(sightings), LEAST_SHARE))
    points, rays = np.ascontiguousarray(sightings.points), sightings.seen[:, :2].copy()
    found, turn, shift, _ = cv2.solvePnPRansac(
        points, rays, np.eye(3), None, iterationsCount=rounds, reprojectionError=reach,
        confidence=0.9999, flags=cv2.SOLVEPNP_P3P,
    )  # fmt: skip
    if not found:
        return np.eye(4), 0
    pose = invert(make_transform(so3_exp(turn[:, 0]), shift[:, 0]))
    return _polished(pose, int(np.count_nonzero(inliers(pose, sightings, limit))), sightings, limit)


def _polished(pose: Array, count: int, sightings: Sightings, limit: float) -> tuple[Array, int]:
    """The pose refined on all within twice the limit, as long as more agree; and how many do."""
    while True:
        refined, _ = refine_pose(pose, sightings.chosen(inliers(pose, sightings, 2.0 * limit)))
        agreed = int(np.count_nonzero(inliers(refined, sightings, limit)))
        if agreed <= count:
            return pose, count
        pose, count = refined, agreed


def refine_pose(start: Array, sightings: Sightings, *, width: float = 2.0) -> tuple[Array, Array]:
    """map_from_camera (4, 4) of least robust error, and its information (6, 6), rotation first.

    Near `start` (4, 4). Gauss-Newton on reprojection and inverse depth with Huber's weights from
    `width` sigmas on; a step that makes things worse is taken back and ends it.
    """
    pose = trial = np.ascontiguousarray(start, np.float64)
    seen, information, best = (sightings.seen, sightings.sigmas), np.eye(6), np.inf
    while True:
        equations, gradient = np.zeros((6, 6)), np.zeros(6)
        cost = pose_normal_equations(trial, sightings.points, *seen, width, equations, gradient)
        if not cost < best:
            return pose, information
        pose, information = trial, equations
        if best - cost < 1e-4 * cost:
            return pose, information
        best = cost
        damping = np.diag(1e-6 * equations.diagonal() + 1e-9)
        trial = trial @ se3_exp(np.linalg.solve(equations + damping, -gradient))


def _rounds_needed(share: float) -> int:
    """Hypotheses of which one is right but for `_MISS`, where this share of sightings is."""
    chance = min(share**3, 1.0 - _MISS)
    return int(np.ceil(np.log(_MISS) / np.log1p(-chance)))
