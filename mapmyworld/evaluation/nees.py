"""Whether a map's covariances are consistent: its errors against the truth, in their sigmas.

Bar-Shalom, Li, Kirubarajan, "Estimation with applications to tracking and navigation" (2001): the
normalised estimation error squared (NEES) of a consistent estimate is its number of unknowns.
"""

from __future__ import annotations

import numpy as np

from mapmyworld.evaluation.association import MAX_DIFFERENCE_S, associate
from mapmyworld.geometry import Array
from mapmyworld.geometry.rigid import between, se3_log
from mapmyworld.types import Node, Poses, Trajectory


def map_nees(
    nodes: tuple[Node, ...], poses: Poses, truth: Trajectory,
    max_difference_s: float = MAX_DIFFERENCE_S,
) -> float | None:  # fmt: skip
    """NEES of a map's nodes per unknown of a pose, so that 1 is consistent.

    None where the map has no covariances, or fewer than two nodes a truth.
    """
    if poses.covariances is None or len(nodes) < 2:
        return None
    row = {int(i): k for k, i in enumerate(poses.ids)}
    placed = [node for node in nodes if node.id in row]
    rows = np.array([row[node.id] for node in placed], np.int64)
    stamps = np.array([node.stamp_ns for node in placed], np.int64)
    e, r = associate(Trajectory(stamps, poses.map_from_node[rows]), truth, max_difference_s)
    if len(e) < 2:
        return None
    return nees(poses.map_from_node[rows[e]], poses.covariances[rows[e]], truth.poses[r])


def nees(map_from_node: Array, covariances: Array, truth: Array) -> float | None:
    """Per unknown, of poses (N, 4, 4) against the true ones (N, 4, 4).

    With covariances (N, 6, 6) relative to the first of them; None where none has an uncertainty.
    """
    from_first = between(truth[:1], truth), between(map_from_node[:1], map_from_node)
    errors = se3_log(between(*from_first))
    variances = covariances.diagonal(0, 1, 2)
    open_ = np.flatnonzero(variances.max(axis=0) > 0.0)  # the plane's, of a planar map
    known = (variances[:, open_] > 0.0).all(axis=1)
    if len(open_) == 0 or not known.any():
        return None
    left, spread = errors[known][:, open_], covariances[known][:, open_[:, None], open_]
    squares = np.einsum("ni,ni->n", left, np.linalg.solve(spread, left[:, :, None])[:, :, 0])
    return float(squares.mean() / len(open_))
