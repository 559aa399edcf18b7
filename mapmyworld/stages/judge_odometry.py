"""Once a log is tracked: what later scans report of sections that odometry alone bridged."""

from __future__ import annotations

from collections.abc import Sequence

from mapmyworld.config import Config
from mapmyworld.odometry.tracking_losses import named_moments
from mapmyworld.types import Judged, MapStore, Why


def judge_odometry(store: MapStore, config: Config) -> list[str]:
    """Replaces motions by odometry that later scans refute; one line that says where, if any."""
    from mapmyworld.places.laser_nodes import load_node_scans, nodes_at
    from mapmyworld.places.refuted_odometry import is_unsupported, refuted_odometry

    constraints = store.constraints()
    if not any(is_unsupported(c) for c in constraints):
        return []
    nodes = nodes_at(load_node_scans(store, config), None)
    judged = refuted_odometry(nodes, constraints, config)
    store.judge(judged)
    return _notes(store, judged)


def _notes(store: MapStore, judged: Sequence[Judged]) -> list[str]:
    refuted = [c for c in judged if c.verdicts and c.verdicts[-1].why is Why.REFUTED]
    if not refuted:
        return []
    stamps = {node.id: node.stamp_ns for node in store.nodes()}
    when = named_moments([stamps[c.from_id] for c in refuted], min(stamps.values()))
    found = [c.verdicts[-1].numbers for c in refuted]
    metres, degrees = (max(numbers[key] for numbers in found) for key in ("metres", "degrees"))
    return [
        f"odometry fault after {when}: later scans place the robot up to {metres:.1f} m and "
        f"{degrees:.0f} deg from there; it was carried, or its wheels slipped"
    ]
