"""The wide search: where a long path was driven and nothing recognised."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import replace

import numpy as np

from mapmyworld.backend.connected_components import components
from mapmyworld.config import Config
from mapmyworld.geometry import Index
from mapmyworld.places.laser_candidates import MOST, NEAR
from mapmyworld.places.laser_nodes import LaserNodes, NodeScans, calm_spots, sessions_of
from mapmyworld.types import CLOSURES, ConstraintKind, Judged

_CLOSURES = CLOSURES | {ConstraintKind.USER}


def lost_pairs(nodes: LaserNodes, config: Config) -> list[tuple[int, int]]:
    """(earlier, later) indices of places of a session that drift may have moved apart, however far.

    The nearest place of an earlier visit need not be the true one when poses are metres off:
    so every place within reach of the drift is compared, or of many some all over that reach.
    """
    size = config.places.laser_submap
    earlier = calm_spots(nodes, size)
    pairs: list[tuple[int, int]] = []
    for later in calm_spots(nodes, 2.0 * size).tolist():
        near = earlier[(earlier < later) & (nodes.session[earlier] == nodes.session[later])]
        drift = nodes.drift.metres(near, later)
        apart = np.hypot(*(nodes.poses[near, :2] - nodes.poses[later, :2]).T)
        worth = near[(drift > NEAR) & (apart < size + drift)]
        pairs += [(int(k), later) for k in worth[:: max(math.ceil(len(worth) / MOST), 1)]]
    return pairs


def held_by(nodes: LaserNodes, constraints: Iterable[Judged]) -> LaserNodes:
    """The nodes, knowing which accepted closures hold them, and with joined sessions as one."""
    closures = _closures(constraints)
    session = _joined(nodes.ids, nodes.session, closures)
    row = {int(i): k for k, i in enumerate(nodes.ids)}
    ends = [(row[c.from_id], row[c.to_id]) for c in closures if {c.from_id, c.to_id} <= row.keys()]
    drift = nodes.drift.held_by(np.array(ends, np.int64).reshape(-1, 2))
    return replace(nodes, drift=drift, session=session)


def joined_sessions(loaded: NodeScans, constraints: Iterable[Judged]) -> Index:
    """(N,) number of each node's session, those as one that accepted closures join."""
    ids = np.array([node.id for node in loaded.nodes], np.int64)
    return _joined(ids, sessions_of(loaded.variances), _closures(constraints))


def _closures(constraints: Iterable[Judged]) -> list[Judged]:
    return [c for c in constraints if c.accepted and c.kind in _CLOSURES]


def _joined(ids: Index, session: Index, closures: Sequence[Judged]) -> Index:
    """(N,) numbers of sessions, those as one that closures tie."""
    if not closures or not session.any():
        return session
    ends = np.array([(c.from_id, c.to_id) for c in closures])
    ends = ends[np.isin(ends, ids).all(axis=1)]
    a, b = session[np.searchsorted(ids, ends)].T
    return components(int(session.max()) + 1, a, b)[session]
