"""The figures of a map that terminal, report and `inspect` show: each is found here alone."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mapmyworld.backend.connected_components import components, positions
from mapmyworld.geometry import Array
from mapmyworld.geometry.planar import covariance_from_planar
from mapmyworld.graph.audit import counts_of
from mapmyworld.types import CLOSURES, ConstraintKind, Judged, MapStore, Node, Poses, TrackedFrames

_CLOSURES = CLOSURES | {ConstraintKind.USER}


@dataclass(frozen=True, slots=True)
class MapFigures:
    """What a map is made of."""

    nodes: int
    sessions: int
    frames: int
    path_m: float
    """From node to node, without what lies between sessions or where tracking was lost."""
    begun_ns: int | None
    """Stamp of the first node; None without one."""
    duration_s: float
    """From the first tracked frame of each session to its last."""
    constraints: dict[str, dict[str, int]]
    """Kind -> tried, accepted, rejected."""
    closures: dict[str, int]
    """The same of all kinds that say: we have been here before."""
    components: tuple[tuple[int, int, int], ...]
    """First node, last node and number of nodes of what nothing ties to the rest."""


def map_figures(store: MapStore) -> MapFigures:
    """The figures of a map; by tracked poses where its graph is not solved."""
    nodes, constraints = store.nodes(), store.constraints()
    poses = store.poses() or tracked_poses(nodes)
    frames = store.tracked_frames() if nodes else None
    counts = counts_of(constraints)
    closures = [counts[kind] for kind in map(str, _CLOSURES) if kind in counts]
    return MapFigures(
        nodes=len(nodes),
        sessions=len({node.session for node in nodes}),
        frames=0 if frames is None else len(frames.stamps_ns),
        path_m=_path(nodes, poses, constraints),
        begun_ns=nodes[0].stamp_ns if nodes else None,
        duration_s=0.0 if frames is None else _duration(nodes, frames.node_ids, frames.stamps_ns),
        constraints=counts,
        closures={
            name: sum(row[name] for row in closures) for name in ("tried", "accepted", "rejected")
        },
        components=components_of(constraints, poses, divides_of(store)),
    )


def divides_of(store: MapStore) -> frozenset[int]:
    """Nodes of which nothing indicates how they lie to the node before: tracking was lost there."""
    return frozenset((store.get("solve") or {}).get("divides", ()))


def calibrated_constraints(store: MapStore) -> tuple[Judged, ...]:
    """The constraints of a map, with the covariances that its solution found them to have."""
    return calibrated(store.constraints(), variance_factors_of(store))


def calibrated(constraints: Sequence[Judged], factors: Mapping[str, float]) -> tuple[Judged, ...]:
    """The constraints with covariances scaled by their kinds' factors, 1 of those left out."""
    return tuple(
        replace(c, information=c.information / factors[c.kind]) if c.kind in factors else c
        for c in constraints
    )


def variance_factors_of(store: MapStore) -> dict[str, float]:
    """The factors of `mapmyworld.graph.variance` that were estimated on a map as it was solved."""
    return dict((store.get("solve") or {}).get("variance_factors", {}))


def scan_noise_of(store: MapStore) -> Array | None:
    """(6, 6) covariance of a node by its own scan's noise, rotation first; None without scans."""
    variances = (store.get("solve") or {}).get("scan_noise")
    return covariance_from_planar(np.diag(variances)) if variances else None


def components_of(
    constraints: Sequence[Judged], poses: Poses, divides: Collection[int]
) -> tuple[tuple[int, int, int], ...]:
    """First node, last node and number of nodes of each connected component.

    `divides`: nodes whose constraint to the node before ties nothing.
    """
    ties = [
        c for c in constraints if c.accepted and not (c.is_tracking_loss and c.to_id in divides)
    ]
    known = np.sort(poses.ids)
    ends = np.array([(c.from_id, c.to_id) for c in ties], np.int64)
    places = positions(known, ends.ravel()).reshape(-1, 2)
    places = places[(places >= 0).all(axis=1)]
    part = components(len(known), places[:, 0], places[:, 1])
    members = [known[part == k] for k in range(int(part.max(initial=-1)) + 1)]
    return tuple((int(m[0]), int(m[-1]), len(m)) for m in members if m[-1] > 0)  # no landmarks


def tracked_poses(nodes: Sequence[Node]) -> Poses:
    """Where tracking alone puts the nodes."""
    ids = np.array([node.id for node in nodes], np.int64)
    return Poses(ids, np.array([node.tracked_from_base for node in nodes]).reshape(-1, 4, 4))


def tracked_path(nodes: Sequence[Node], frames: TrackedFrames) -> Array:
    """Poses (F, 4, 4) of all frames as the tracker had them."""
    tracked = {node.id: node.tracked_from_base for node in nodes}
    return np.stack([tracked[i] for i in frames.node_ids.tolist()]) @ frames.node_from_frame


def contradictions_of(solved: Mapping[str, Any]) -> list[str]:
    """What a solution contradicts, one line each; its components are listed by themselves."""
    parted = solved.get("parted", ())
    return [line for line in solved.get("losses", ()) if line not in parted]


def _path(nodes: Sequence[Node], poses: Poses, constraints: Sequence[Judged]) -> float:
    """Metres; by nodes, since the noise of frames adds up to a longer path than was driven."""
    place = dict(zip(poses.ids.tolist(), poses.map_from_node[:, :3, 3], strict=True))
    known = [node for node in nodes if node.id in place]
    lost = {c.to_id for c in constraints if c.is_tracking_loss}
    steps = [
        place[after.id] - place[before.id]
        for before, after in pairwise(known)
        if after.session == before.session and after.id not in lost
    ]
    return float(np.linalg.norm(np.reshape(steps, (-1, 3)), axis=1).sum())


def _duration(
    nodes: Sequence[Node], node_ids: NDArray[np.int64], stamps_ns: NDArray[np.int64]
) -> float:
    """Seconds of all sessions, without those between them."""
    session_of = {node.id: node.session for node in nodes}
    sessions = np.array([session_of[i] for i in node_ids.tolist()])
    spans = [np.ptp(stamps_ns[sessions == session]) for session in np.unique(sessions)]
    return float(sum(spans)) * 1e-9
