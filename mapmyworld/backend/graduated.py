"""Which edges contradict the others: graduated non-convexity with truncated least squares.

Yang, Antonante, Tzoumas, Carlone, "Graduated non-convexity for robust spatial perception" (2020).
Odometry keeps weight 1; closures end with weight 0 or 1. gtsam's own begins every round at the
start again: on manhattan with half of the closures false it takes ten times as long.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import diags_array

from mapmyworld.backend.factors import FactorGraph, factor_graph
from mapmyworld.backend.information import Factorised, Variables, normal_matrix
from mapmyworld.backend.residuals import retract
from mapmyworld.backend.system import System, believed_edges, edge_chi2, moving_edges
from mapmyworld.geometry import Array, Index

_GROWTH = 1.4  # of the control parameter between two rounds, as in the paper
_ROUNDS = 100  # at most


def graduate(
    system: System,
    start: Array,
    trusted: NDArray[np.bool_],
    tried: NDArray[np.bool_],
    limit: float,
) -> tuple[Array, NDArray[np.bool_]]:
    """Poses (N, 3 or 4, 4) and inliers (E,) among the `tried` edges; the others play no part.

    `limit`: the squared sigmas that a true edge stays below. `start` (N, 3 or 4, 4) are poses,
    `trusted` and `tried` (E,) masks of edges.
    """
    part, fixed = believed_edges(system, tried), trusted[tried]
    graph, poses = factor_graph(part, start), start
    among = Variables.of(graph.values)
    order = among.elimination(graph.factors)
    for _ in range(3):
        poses = _stepped(part, graph, among, order, poses, np.ones(len(fixed)))
    chi2 = edge_chi2(part, poses)
    control = first_control(chi2[~fixed], limit)
    for _ in range(_ROUNDS):
        weights = np.where(fixed, 1.0, truncated_weights(chi2, limit, control))
        poses = _stepped(part, graph, among, order, poses, weights)
        chi2 = edge_chi2(part, poses)
        decided = (weights < 1e-3) | (weights > 1.0 - 1e-3)
        if decided.all() and control > 1.0:
            break
        control *= _GROWTH
    inliers = np.zeros(len(tried), np.bool_)
    inliers[np.flatnonzero(tried)] = fixed | (weights > 0.5)
    return poses, inliers


def _stepped(
    part: System, graph: FactorGraph, among: Variables, order: Index, poses: Array, weights: Array
) -> Array:
    """Poses after one Gauss-Newton step of edges that count by their weights (E,)."""
    graph, d = graph.at(part, poses), part.dimension
    jacobian, right = among.jacobian(graph.factors.linearize(graph.values))
    kinds = np.zeros(len(weights), np.int64) if part.kinds is None else part.kinds
    rows = np.where(kinds > 0, 2 if part.planar else 3, d)[moving_edges(part)]
    roots = np.sqrt(np.repeat(weights[moving_edges(part)], rows))
    weighted = diags_array(roots) @ jacobian
    normal = normal_matrix(weighted, order)
    step = Factorised.of(normal, order).solve(weighted.T @ (roots * right))
    tangents = np.zeros((len(poses), d))
    unknown = np.tile((part.free >= 0)[:, None], d)
    unknown[part.points] &= np.arange(d) < 2 if part.planar else np.arange(d) >= 3
    tangents[unknown] = step
    return retract(part.planar, poses, tangents)


def first_control(chi2: Array, limit: float) -> float:
    """The control parameter at which the loss is convex over the largest of squared sigmas (E,)."""
    worst = float(chi2.max(initial=0.0))
    return 1e3 if 2.0 * worst <= limit else limit / (2.0 * worst - limit)


def truncated_weights(chi2: Array, limit: float, control: float) -> Array:
    """Weights (E,) of squared sigmas (E,) in closed form (equation 14 of the paper)."""
    middle = np.sqrt(limit * control * (control + 1.0) / np.maximum(chi2, 1e-12)) - control
    weights = np.clip(middle, 0.0, 1.0)
    weights[chi2 >= limit * (control + 1.0) / control] = 0.0
    weights[chi2 <= limit * control / (control + 1.0)] = 1.0
    return np.asarray(weights)
