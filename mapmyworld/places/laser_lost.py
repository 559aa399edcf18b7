"""Where a long way was driven and nothing recognised: there the search widens."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from mapmyworld.config import Config
from mapmyworld.places.laser_nodes import Index, LaserNodes, calm_spots
from mapmyworld.types import CLOSURES, Constraint, ConstraintKind

_CLOSURES = CLOSURES | {ConstraintKind.USER}
_LONG = 75.0  # m of way without a closure from which two places may be far from where they seem
_LATER, _EARLIER = 8.0, 4.0  # m of path between the places that look, and that are looked at
_MOST = 16  # earlier places that one is compared with
_NEAR = 3.0  # m between two places that see the same


def lost_pairs(
    nodes: LaserNodes, constraints: Iterable[Constraint], config: Config
) -> list[tuple[int, int]]:
    """(earlier, later) indices of places that drift may have moved apart, however far.

    The nearest place of an earlier visit need not be the true one when poses are metres off:
    so every place within reach of the drift is compared, nearest first.
    """
    loose = loose_way(nodes, constraints)
    earlier = calm_spots(nodes, _EARLIER)
    tree = cKDTree(nodes.poses[earlier, :2])
    pairs: list[tuple[int, int]] = []
    for later in calm_spots(nodes, _LATER).tolist():
        widest = _NEAR + config.places.laser_window
        near = earlier[sorted(tree.query_ball_point(nodes.poses[later, :2], widest))]
        drifted = np.minimum(nodes.path[later] - nodes.path[near], loose[later] + loose[near])
        apart = np.hypot(*(nodes.poses[near, :2] - nodes.poses[later, :2]).T)
        worth = (drifted > _LONG) & (apart < _NEAR + config.places.laser_drift * drifted)
        chosen = near[worth][np.argsort(apart[worth], kind="stable")[:_MOST]]
        pairs += [(int(place), later) for place in np.sort(chosen)]
    return pairs


def loose_way(nodes: LaserNodes, constraints: Iterable[Constraint]) -> NDArray[np.float64]:
    """(N,) metres of path from each node to the nearest one with an accepted closure."""
    ends = {
        i for c in constraints if c.accepted and c.kind in _CLOSURES for i in (c.from_id, c.to_id)
    }
    tied: Index = np.flatnonzero(np.isin(nodes.ids, list(ends)))
    if len(tied) == 0:
        return np.full(len(nodes.ids), np.inf)
    after = np.minimum(np.searchsorted(tied, np.arange(len(nodes.ids))), len(tied) - 1)
    before = np.maximum(after - 1, 0)
    way = nodes.path[:, None] - nodes.path[np.stack([tied[before], tied[after]], axis=1)]
    return np.asarray(np.abs(way).min(axis=1))
