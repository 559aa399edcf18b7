"""Once a log is tracked: what later scans report of sections that odometry alone bridged."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from mapmyworld.config import Config
from mapmyworld.odometry.tracking_losses import named_moments
from mapmyworld.odometry.unobserved_motion import GOES_ON
from mapmyworld.parallel import on_one_thread
from mapmyworld.types import Judged, LaserTracking, MapStore, Why


@on_one_thread
def judge_odometry(store: MapStore, config: Config) -> list[str]:
    """Replaces motions by odometry that later scans refute; one line that says where, if any."""
    from mapmyworld.places.laser_nodes import load_node_scans, nodes_at
    from mapmyworld.places.refuted_odometry import refuted_odometry

    constraints = store.constraints()
    unobserved = {c.to_id for c in constraints if is_unmatched(c)} | _after_gaps(store)
    if not unobserved:
        return []
    nodes = nodes_at(load_node_scans(store, config), None)
    judged = refuted_odometry(nodes, constraints, unobserved, config)
    store.judge(judged)
    return _notes(store, judged)


def is_unmatched(c: Judged) -> bool:
    """Whether scans fitted nothing on the way, so that odometry alone reports the motion."""
    return isinstance(c.source, LaserTracking) and c.source.state == "odometry only"


def _after_gaps(store: MapStore) -> set[int]:
    """Nodes before which the log has no scan for longer than it usually has none."""
    frames = store.tracked_frames()
    took = 1e-9 * np.diff(frames.stamps_ns)
    if not len(took):
        return set()
    gaps = np.flatnonzero(took > max(GOES_ON, 3.0 * float(np.quantile(took, 0.95))))
    ids = np.sort(frames.node_ids[frames.is_node])
    after = np.searchsorted(ids, frames.node_ids[gaps], side="right")
    return set(ids[after[after < len(ids)]].tolist())


def _notes(store: MapStore, judged: Sequence[Judged]) -> list[str]:
    refuted = [c for c in judged if c.verdicts and c.verdicts[-1].why is Why.REFUTED]
    if not refuted:
        return []
    stamps = {node.id: node.stamp_ns for node in store.nodes()}
    when = named_moments([stamps[c.from_id] for c in refuted], min(stamps.values()))
    farthest = max(c.verdicts[-1].numbers["metres"] for c in refuted)
    return [
        f"odometry fault after {when}: later scans place the robot elsewhere, up to "
        f"{farthest:.1f} m away; it was carried, or its wheels slipped"
    ]
