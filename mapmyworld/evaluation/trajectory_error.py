"""Absolute and relative trajectory error, by the definitions of evo.

Sturm et al., "A benchmark for the evaluation of RGB-D SLAM systems", IROS 2012; Grupp, evo (2017).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mapmyworld.errors import MapError
from mapmyworld.evaluation.association import MAX_DIFFERENCE_S, associate
from mapmyworld.evaluation.error_statistics import ErrorStatistics, summarise
from mapmyworld.geometry import Array
from mapmyworld.geometry.rigid import between
from mapmyworld.geometry.rotations import rotation_angle
from mapmyworld.types import Trajectory

_UPRIGHT = 1e-9  # of the covariance: what the vertical counts in it beside the points


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


def rigid_alignment(a: Array, b: Array) -> Array:
    """`a_from_b` (4, 4) that minimises the squared distances of paired points, (N, 3) both.

    Umeyama, "Least-squares estimation of transformation parameters between two point patterns",
    PAMI 13(4), 1991, equations 34 to 43 with scale 1. Of the rotations that points on one line
    leave open (of a robot that drove straight) it is the one that keeps up upright.
    """
    covariance = (a - a.mean(0)).T @ (b - b.mean(0)) / len(a)
    covariance[2, 2] += _UPRIGHT * max(float(np.abs(covariance).max()), 1e-300)
    left, _, right = np.linalg.svd(covariance)
    signs = np.array([1.0, 1.0, np.sign(np.linalg.det(left) * np.linalg.det(right))])
    motion = np.eye(4)
    motion[:3, :3] = (left * signs) @ right
    motion[:3, 3] = a.mean(0) - motion[:3, :3] @ b.mean(0)
    return motion
