"""How honest a map's covariances are: errors against the truth, in what the map claims of them.

Bar-Shalom, Li, Kirubarajan, "Estimation with applications to tracking and navigation" (2001): the
normalised estimation error squared (NEES) of an honest estimate is its number of unknowns.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from mapmyworld.evaluation.association import MAX_DIFFERENCE_S, associate
from mapmyworld.geometry.rigid import between, se3_log
from mapmyworld.types import Node, Poses, Trajectory

Array = NDArray[np.float64]


def map_nees(
    nodes: tuple[Node, ...], poses: Poses, truth: Trajectory,
    max_difference_s: float = MAX_DIFFERENCE_S,
) -> float | None:  # fmt: skip
    """NEES of a map's nodes for every unknown of a pose, so that 1 is honest; None where the map
    has no covariances, or fewer than two nodes a truth.
    """
    if poses.covariances is None or len(nodes) < 2:
        return None
    row = {int(i): k for k, i in enumerate(poses.ids)}
    known = [node for node in nodes if node.id in row]
    rows = np.array([row[node.id] for node in known], np.int64)
    stamps = np.array([node.stamp_ns for node in known], np.int64)
    e, r = associate(Trajectory(stamps, poses.map_from_node[rows]), truth, max_difference_s)
    if len(e) < 2:
        return None
    return nees(poses.map_from_node[rows[e]], poses.covariances[rows[e]], truth.poses[r])


def nees(map_from_node: Array, covariances: Array, truth: Array) -> float | None:
    """Of poses (N, 4, 4) with covariances (N, 6, 6) relative to the first of them, for every
    unknown; None where none has an uncertainty.
    """
    from_first = between(truth[:1], truth), between(map_from_node[:1], map_from_node)
    errors = se3_log(between(*from_first))
    variances = covariances.diagonal(0, 1, 2)
    open_ = np.flatnonzero(variances.max(axis=0) > 0.0)  # the plane's, of a planar map
    sure = (variances[:, open_] > 0.0).all(axis=1)
    if len(open_) == 0 or not sure.any():
        return None
    left, spread = errors[sure][:, open_], covariances[sure][:, open_[:, None], open_]
    squares = np.einsum("ni,ni->n", left, np.linalg.solve(spread, left[:, :, None])[:, :, 0])
    return float(squares.mean() / len(open_))
