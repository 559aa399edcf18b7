"""Precision and recall of loop closures against the true trajectory and the true loops."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mapmyworld.evaluation.relations_metric import poses_at
from mapmyworld.geometry import Array
from mapmyworld.geometry.rigid import between
from mapmyworld.geometry.rotations import rotation_angle
from mapmyworld.types import Trajectory

MAX_DISTANCE = 0.20  # m by which a true closure may be off (Hess et al., ICRA 2016, table IV)
MAX_ANGLE_DEG = 1.0
_NEAR_S = 3.0  # s around a true loop's moments in which a closure finds it


@dataclass(frozen=True, slots=True, eq=False)
class LoopScore:
    """How many accepted closures are right, and how many were missed."""

    precision: float
    """Share of the closures that are right; 1 without any closure."""
    recall: float
    """Share of the moments at which the robot was back somewhere, that have a right closure;
    NaN where there is none."""
    right: NDArray[np.bool_]
    """(K,)."""


def loop_closure_score(
    stamps_ns: NDArray[np.int64],
    first_from_second: Array,
    truth: Trajectory,
    true_pairs_ns: NDArray[np.int64],
) -> LoopScore:
    """Closures between the moments (K, 2), measured as (K, 4, 4), judged by the truth.

    A later moment of a true pair (P, 2) is recalled by any right closure whose one end lies within
    three seconds of it and whose other end lies as near to a moment it is paired with.
    """
    first, second = (poses_at(truth, stamps_ns[:, k]) for k in (0, 1))
    error = between(between(first, second), first_from_second)
    distance = np.linalg.norm(error[:, :3, 3], axis=1)
    angle = np.degrees(rotation_angle(error))
    right = (distance <= MAX_DISTANCE) & (angle <= MAX_ANGLE_DEG)
    return LoopScore(
        precision=float(right.mean()) if len(right) else 1.0,
        recall=_recall(np.sort(stamps_ns[right], axis=1), true_pairs_ns),
        right=right,
    )


def _recall(found_ns: NDArray[np.int64], true_ns: NDArray[np.int64]) -> float:
    if len(true_ns) == 0:
        return float("nan")
    near_ns = round(_NEAR_S * 1e9)
    recalled: dict[int, bool] = {}
    for earlier, later in np.sort(true_ns, axis=1).tolist():
        hit = bool((np.abs(found_ns - [earlier, later]) <= near_ns).all(axis=1).any())
        recalled[later] = recalled.get(later, False) or hit
    return float(np.mean(list(recalled.values())))
