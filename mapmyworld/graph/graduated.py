"""Which edges contradict the others: graduated non-convexity with truncated least squares.

Yang, Antonante, Tzoumas, Carlone, "Graduated non-convexity for robust spatial perception" (2020).
Odometry keeps weight 1; closures end with weight 0 or 1.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from mapmyworld.geometry import Array
from mapmyworld.graph.descent import relax
from mapmyworld.graph.linear_system import pattern_of
from mapmyworld.graph.system import System, believed_edges, edge_chi2

_GROWTH = 1.4  # of the control parameter between two rounds, as in the paper
_ROUNDS = 100  # at most


def graduate(
    system: System,
    start: Array,
    trusted: NDArray[np.bool_],
    tried: NDArray[np.bool_],
    limit: float,
) -> tuple[Array, NDArray[np.bool_]]:
    """Poses and inliers (E,) among the `tried` edges; the others play no part."""
    part, fixed = believed_edges(system, tried), trusted[tried]
    pattern = pattern_of(part)
    weights = np.ones(len(fixed))
    poses = relax(part, pattern, start, weights, 3)
    chi2 = edge_chi2(part, poses)
    control = first_control(chi2[~fixed], limit)
    for _ in range(_ROUNDS):
        weights = np.where(fixed, 1.0, truncated_weights(chi2, limit, control))
        poses = relax(part, pattern, poses, weights, 1)
        chi2 = edge_chi2(part, poses)
        decided = (weights < 1e-3) | (weights > 1.0 - 1e-3)
        if decided.all() and control > 1.0:
            break
        control *= _GROWTH
    inliers = np.zeros(len(tried), np.bool_)
    inliers[np.flatnonzero(tried)] = fixed | (weights > 0.5)
    return poses, inliers


def first_control(chi2: Array, limit: float) -> float:
    """The control parameter at which the loss is convex over the largest residual."""
    worst = float(chi2.max(initial=0.0))
    return 1e3 if 2.0 * worst <= limit else limit / (2.0 * worst - limit)


def truncated_weights(chi2: Array, limit: float, control: float) -> Array:
    """Weights (E,) in closed form (equation 14 of the paper)."""
    middle = np.sqrt(limit * control * (control + 1.0) / np.maximum(chi2, 1e-12)) - control
    weights = np.clip(middle, 0.0, 1.0)
    weights[chi2 >= limit * (control + 1.0) / control] = 0.0
    weights[chi2 <= limit * control / (control + 1.0)] = 1.0
    return weights
