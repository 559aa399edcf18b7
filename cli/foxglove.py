"""From a stored map to a file for Foxglove."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from cli.report import cloud_beside
from formats.foxglove import FoxgloveMap, write_foxglove
from mapmyworld.errors import MapError
from mapmyworld.exporting import frame_poses, solved_poses
from mapmyworld.types import MapStore

_BASE = "base_link"


def export_mcap(
    store: MapStore, path: Path, logs: Sequence[Path]
) -> tuple[list[Path], tuple[str, ...]]:
    """What was written, and what of the log could not be.

    Raises `MapError` where the map was made of another log.
    """
    shown = foxglove_map(store)
    if not logs:
        return write_foxglove(path, shown, (store.node_data(n.id) for n, _, _ in shown.nodes)), ()
    from formats.foxglove.replay import write_replay
    from formats.logs import open_log

    log = open_log(logs)
    known = store.get("log")
    if known is not None and known["hash"] != log.content_hash():
        made_of = ", ".join(known["paths"])
        raise MapError(f"{logs[0]}: the map was made of another log: give {made_of}")
    frames = store.tracked_frames()
    odometry = frames.odom_from_base
    if odometry is not None:
        odometry = odometry[frame_poses(store)[0]]
    return write_replay(path, shown, log, odometry)


def foxglove_map(store: MapStore) -> FoxgloveMap:
    """Raises `MapError` where the map holds no nodes."""
    poses = solved_poses(store)
    indices, map_from_base = frame_poses(store)
    place = {int(i): k for k, i in enumerate(poses.ids)}
    covariances = poses.covariances
    nodes = [
        (
            node,
            poses.map_from_node[place[node.id]],
            None if covariances is None else covariances[place[node.id]],
        )
        for node in store.nodes()
        if node.id in place
    ]
    plan = store.get("plan") or {}
    return FoxgloveMap(
        base_frame=str(plan.get("base_frame") or _BASE).lstrip("/"),
        stamps_ns=np.asarray(store.tracked_frames().stamps_ns[indices]),
        map_from_base=map_from_base,
        nodes=nodes,
        constraints=store.constraints(),
        grid=store.grid(),
        cloud=cloud_beside(store),
    )
