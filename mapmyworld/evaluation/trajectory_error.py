"""Absolute and relative trajectory error, by the definitions of evo.

Sturm et al., "A benchmark for the evaluation of RGB-D SLAM systems", IROS 2012; Grupp, evo (2017).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from mapmyworld.errors import MapError
from mapmyworld.evaluation.association import MAX_DIFFERENCE_S, associate
from mapmyworld.evaluation.error_statistics import ErrorStatistics, summarise
from mapmyworld.geometry import Array
from mapmyworld.geometry.rigid import between
from mapmyworld.geometry.rotations import rotation_angle
from mapmyworld.types import Trajectory

_RANK_TOLERANCE = 1e-12  # of a singular value, relative to the largest, to count as zero


@dataclass(frozen=True, slots=True, eq=False)
class TrajectoryScore:
    """Errors of an estimate against its reference, pose by pose (ATE) or pair by pair (RPE)."""

    translation: ErrorStatistics
    """Metres."""
    rotation_deg: ErrorStatistics
    reference_from_estimate: Array
    """(4, 4) the alignment that was applied; the identity without one."""

    @property
    def rmse(self) -> float:
        """Of translation, metres: the figure that papers call ATE (or RPE)."""
        return self.translation.rmse


def ate(
    estimate: Trajectory,
    reference: Trajectory,
    *,
    align: bool = True,
    max_difference_s: float = MAX_DIFFERENCE_S,
) -> TrajectoryScore:
    """Distance of every pose from its true place, after the best rigid alignment if asked."""
    e, r = associate(estimate, reference, max_difference_s)
    poses, truth = estimate.poses[e], reference.poses[r]
    alignment = rigid_alignment(truth[:, :3, 3], poses[:, :3, 3]) if align else np.eye(4)
    return _scored(alignment @ poses, truth, alignment)


def rpe(
    estimate: Trajectory,
    reference: Trajectory,
    *,
    distance: float = 0.0,
    frames: int = 1,
    max_difference_s: float = MAX_DIFFERENCE_S,
) -> TrajectoryScore:
    """Error of the motion between consecutive poses `frames` apart, or `distance` metres.

    With a distance, pairs are laid end to end along the estimate's path, as evo does. Raises
    `MapError` where no two matched poses are so far apart.
    """
    e, r = associate(estimate, reference, max_difference_s)
    poses, truth = estimate.poses[e], reference.poses[r]
    ends = _ends_by_path(poses, distance) if distance > 0.0 else np.arange(0, len(poses), frames)
    if len(ends) < 2:
        asked = f"{distance} m" if distance > 0.0 else f"{frames} frames"
        raise MapError(f"no two of {len(poses)} matched poses are {asked} apart: ask for less")
    first, second = ends[:-1], ends[1:]
    moved, truly = between(poses[first], poses[second]), between(truth[first], truth[second])
    return _scored(moved, truly, np.eye(4))


def _scored(estimate: Array, truth: Array, alignment: Array) -> TrajectoryScore:
    error = between(truth, estimate)
    translation = np.linalg.norm(error[:, :3, 3], axis=1)
    rotation = np.degrees(rotation_angle(error))
    return TrajectoryScore(summarise(translation), summarise(rotation), alignment)


def _ends_by_path(poses: Array, distance: float) -> NDArray[np.int64]:
    """Indices of poses at which `distance` was travelled since the last such pose."""
    steps = np.linalg.norm(np.diff(poses[:, :3, 3], axis=0), axis=1)
    ends, travelled = [0], 0.0
    for index, step in enumerate(steps, start=1):
        travelled += float(step)
        if travelled >= distance:
            ends.append(index)
            travelled = 0.0
    return np.array(ends, np.int64)


def rigid_alignment(a_points: ArrayLike, b_points: ArrayLike) -> Array:
    """`a_from_b` (D+1, D+1) that minimises the squared distances of paired points, (N, D) both.

    Umeyama, "Least-squares estimation of transformation parameters between two point patterns",
    PAMI 13(4), 1991, equations 34 to 43 with scale 1. Points in three dimensions that all lie on
    one line leave the rotation about it open: then only x and y are aligned, if that is possible
    (a robot that drove straight), else any of the best rotations is taken.
    """
    a, b = np.asarray(a_points, np.float64), np.asarray(b_points, np.float64)
    dimension = a.shape[1]
    left, singular, right = np.linalg.svd((a - a.mean(0)).T @ (b - b.mean(0)) / len(a))
    on_a_line = np.count_nonzero(singular > _RANK_TOLERANCE * max(singular[0], 1e-300)) < 2
    if dimension == 3 and on_a_line:
        planar, motion = rigid_alignment(a[:, :2], b[:, :2]), np.eye(4)
        motion[:2, :2], motion[:2, 3] = planar[:2, :2], planar[:2, 2]
        motion[2, 3] = a[:, 2].mean() - b[:, 2].mean()
        return motion
    signs = np.ones(dimension)
    signs[-1] = np.sign(np.linalg.det(left) * np.linalg.det(right))
    rotation = (left * signs) @ right
    motion = np.eye(dimension + 1)
    motion[:-1, :-1] = rotation
    motion[:-1, -1] = a.mean(0) - rotation @ b.mean(0)
    return motion
