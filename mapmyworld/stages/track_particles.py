"""The stages of `--method fastslam`: particles give the path, the store keeps it as any other."""

from __future__ import annotations

from collections.abc import Iterable
from functools import partial

import numpy as np

from mapmyworld.config import Config
from mapmyworld.errors import LogError
from mapmyworld.geometry import Array
from mapmyworld.geometry.planar import covariance_from_planar, planar_to_matrix
from mapmyworld.graph.frame_poses import pose_every_frame
from mapmyworld.particles.fastslam import run_fastslam
from mapmyworld.places.laser_nodes import load_node_scans, nodes_at
from mapmyworld.places.misplaced import misplaced_places
from mapmyworld.sensing import Plan, read_frames
from mapmyworld.stages.first_pass import wheels_of_log
from mapmyworld.stages.nodes import Motion
from mapmyworld.stages.track import track
from mapmyworld.stages.trackers import Followed, Tracker
from mapmyworld.types import Frame, LogSource, MapStore, Particles, Poses, Progress

_STEP_COVARIANCE = np.diag([1e-8, 1e-8, 1e-6, 1e-6, 1e-6, 1e-8])  # of one step of a smoothed path


def track_particles(
    log: LogSource, plan: Plan, store: MapStore, config: Config, progress: Progress
) -> None:
    """Filters the log with particles, then writes frames and nodes along the best one's path.

    Raises `LogError` where the log has no usable scan.
    """
    if plan.scan is None:
        raise LogError("--method fastslam needs a laser: this log has no usable scan")
    frames = read_frames(log, plan, config.sensing, inertial=False)
    wheels = wheels_of_log(log, plan, config, progress)
    result = run_fastslam(frames, config, progress, wheels)
    losses = (*result.losses, *_lost(result.times_lost))
    tracker = Tracker(partial(_follow_path, result.path), lambda: result.notes, lambda: losses)
    track(log, plan, store, config, progress, tracker)
    tracked = store.tracked_frames()
    spread = result.covariances[: len(tracked.stamps_ns)][tracked.is_node]
    store.put("particle_spread", spread.reshape(-1, 9).tolist())
    store.put("particles", result.summary)
    store.put("particle_paths", result.paths)


def finish_particles(store: MapStore, config: Config) -> None:
    """The best particle's path as the map's poses, its spread as their covariances.

    Of particles that are all wrong one is the best: what the map contradicts shows it.
    """
    nodes = store.nodes()
    spread = np.array(store.get("particle_spread")).reshape(-1, 3, 3)
    covariances = covariance_from_planar(spread[: len(nodes)])
    ids = np.array([node.id for node in nodes], np.int64)
    poses = Poses(ids, np.stack([node.tracked_from_base for node in nodes]), covariances)
    store.set_poses(poses)
    store.set_frame_poses(pose_every_frame(nodes, poses, store.tracked_frames()))
    loaded = load_node_scans(store, config)
    found, losses = misplaced_places(nodes_at(loaded, poses)), list[str]()
    if found.fell_apart:
        losses.append(
            f"the particle filter diverged: {found.named(loaded.nodes)}; use --method graph, or "
            "increase particles.count"
        )
    store.put("solve", {"losses": losses})


def _follow_path(path: Array, frames: Iterable[Frame]) -> Followed:
    """Gives the frames with a scan, one after the other, the poses of a finished path."""
    with_scan = (frame for frame in frames if frame.scan is not None)
    for frame, pose in zip(with_scan, planar_to_matrix(path), strict=True):
        yield frame, Motion(pose, _STEP_COVARIANCE, Particles())


def _lost(times: int) -> tuple[str, ...]:
    """No particle is drawn farther off than the scan matcher reaches."""
    if not times:
        return ()
    return (
        f"tracking was lost {times} times without odometry, and the particle filter has no global "
        "search: the map may be wrong from there on; use --method graph",
    )
