"""The nodes that a laser saw something from: their scans made ready, their place on the path."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from mapmyworld.backend.connected_components import components
from mapmyworld.config import Config
from mapmyworld.geometry import Array, Index
from mapmyworld.geometry.planar import between_planar, matrix_to_planar, wrap_angle
from mapmyworld.odometry.pose_hypotheses import FEWEST
from mapmyworld.odometry.unobserved_motion import FARTHEST
from mapmyworld.places.node_drift import NodeDrift
from mapmyworld.places.stored_scans import Scans, StoredScans
from mapmyworld.types import CLOSURES, Constraint, ConstraintKind, Judged, MapStore, Node, Poses

_CLOSURES = CLOSURES | {ConstraintKind.USER}


@dataclass(frozen=True, slots=True, eq=False)
class LaserNodes:
    """The nodes that have scans, their scans, and where they are thought to be."""

    ids: Index
    """(N,) ids of nodes."""
    scans: Scans
    poses: Array
    """(N, 3)."""
    path: Array
    """(N,) metres driven, rotation counted as well; more than maps reach where tracking was lost or
    scans put the odometry in doubt, so that no submap spans such a motion."""
    drift: NodeDrift
    """By how much they may lie off from each other."""
    sees: NDArray[np.bool_]
    """(N,) whether the scan shows where it was taken: it has points enough, and fits what is
    seen before it or afterwards."""
    session: Index
    """(N,) number of the session, which ends where tracking is lost and odometry with it; those
    that closures join are one."""


class NodeScans(NamedTuple):
    """Nodes that have a scan, and their scans made ready."""

    nodes: list[Node]
    scans: Scans
    lost: NDArray[np.bool_]
    """(N,) whether tracking was lost on the way to the node."""
    sees: NDArray[np.bool_]
    """(N,) whether the scan shows where it was taken: it has points enough, and fits what is
    seen before it or afterwards."""
    doubted: NDArray[np.bool_]
    """(N,) whether scans put the odometry in doubt on the way to it."""


def load_node_scans(store: MapStore, config: Config) -> NodeScans:
    """The nodes that have a scan, with their scans made ready."""
    frames = store.tracked_frames()
    scans = StoredScans(store, np.flatnonzero(frames.is_node), config.registration)
    known = {node.id: node for node in store.nodes()}
    ids = frames.node_ids[scans.frames]
    nodes = [known[i] for i in ids.tolist()]
    constraints = store.constraints()
    unmatched = [c for c in constraints if c.is_unmatched]
    apart = np.isin(ids, [c.from_id for c in unmatched]) & np.isin(
        ids, [c.to_id for c in unmatched]
    )
    lost = led_to(ids, (c for c in constraints if c.is_tracking_loss))
    doubted = led_to(ids, (c for c in constraints if c.accepted and c.is_doubted))
    return NodeScans(nodes, scans, lost, (scans.sizes >= FEWEST) & ~apart, doubted)


def led_to(ids: Index, motions: Iterable[Constraint]) -> NDArray[np.bool_]:
    """(N,) to which of the nodes `ids` (N,), ascending, one of some motions leads.

    To the next one, where the node that it leads to is none of them.
    """
    found = np.zeros(len(ids) + 1, np.bool_)
    found[np.searchsorted(ids, [c.to_id for c in motions])] = True
    return found[:-1]


def laser_nodes(
    ids: Index, scans: Scans, poses: Array, stated: Iterable[Judged] = (),
    lost: NDArray[np.bool_] | None = None, doubted: NDArray[np.bool_] | None = None,
) -> LaserNodes:  # fmt: skip
    """Nodes `ids` (N,) that all see, held by the accepted ones of the `stated` constraints.

    `poses` (N, 3) are map_from_base; `lost` and `doubted` (N,) as in `NodeScans`, by default none.
    """
    never, accepted = np.zeros(len(ids), np.bool_), tuple(c for c in stated if c.accepted)
    lost, doubted = (never if some is None else some for some in (lost, doubted))
    path = metres_driven(poses) + FARTHEST * (np.cumsum(lost) + np.cumsum(doubted))
    session = _joined(ids, np.cumsum(lost), _closures(accepted))
    return LaserNodes(ids, scans, poses, path, NodeDrift(ids, poses, accepted), ~never, session)


def metres_driven(poses: Array) -> Array:
    """(N,) metres of path up to each of some poses (N, 3), rotation counted as well."""
    steps = between_planar(poses[:-1], poses[1:])
    lengths = np.hypot(steps[:, 0], steps[:, 1]) + 0.2 * np.abs(steps[:, 2])
    return np.concatenate([[0.0], np.cumsum(lengths)])


def nodes_at(
    loaded: NodeScans, poses: Poses | None, count: int | None = None,
    stated: Iterable[Judged] = (),
) -> LaserNodes:  # fmt: skip
    """The first `count` nodes at solved poses, at tracked ones without; all of them by default.

    They are held by the accepted ones of the `stated` constraints.
    """
    nodes = loaded.nodes[:count]
    ids = np.array([node.id for node in nodes], np.int64)
    if poses is None:
        matrices = np.stack([node.tracked_from_base for node in nodes])
    else:
        row = {int(i): k for k, i in enumerate(poses.ids)}
        matrices = poses.map_from_node[[row[int(i)] for i in ids]]
    some = slice(0, len(ids))
    found = laser_nodes(
        ids, loaded.scans, matrix_to_planar(matrices), stated, loaded.lost[some],
        loaded.doubted[some],
    )  # fmt: skip
    return replace(found, sees=loaded.sees[some])


def spaced(path: Array, spacing: float) -> Index:
    """(K,) indices of nodes about every `spacing` metres of `path` (N,)."""
    _, first = np.unique(path // spacing, return_index=True)
    return np.unique([*first, len(path) - 1])


def calm_spots(nodes: LaserNodes, spacing: float) -> Index:
    """(K,) one node for every `spacing` metres of path on which one sees.

    It is the one of the first half of them at which the robot turns most evenly: where a turn
    begins between two samples of the odometry, a sweep, and so its node and every closure with it,
    may be turned by more than a degree, and nothing in the scans indicates it.
    """
    seeing = np.flatnonzero(nodes.sees)
    half = nodes.path[seeing] // (0.5 * spacing)
    section = half // 2
    calmest = np.lexsort((_unevenness(nodes)[seeing], half))
    return np.sort(seeing[calmest[np.diff(section[calmest], prepend=-1.0) > 0.0]])


def _unevenness(nodes: LaserNodes) -> Array:
    """(N,) rad by which the turn from each node differs from the turn to it."""
    turns = wrap_angle(np.diff(nodes.poses[:, 2], prepend=nodes.poses[0, 2]))
    return np.abs(np.diff(turns, append=turns[-1:]))


def joined_sessions(loaded: NodeScans, constraints: Iterable[Judged]) -> Index:
    """(N,) number of each node's session, those as one that accepted closures join."""
    ids = np.array([node.id for node in loaded.nodes], np.int64)
    return _joined(ids, np.cumsum(loaded.lost), _closures(constraints))


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
