"""All comparisons of one log: of its first minutes, or along the path once it was tracked."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from mapmyworld.config import Config
from mapmyworld.diagnosis.finding import Finding
from mapmyworld.diagnosis.lasers import distance_scale, laser_findings
from mapmyworld.diagnosis.rotation import time_offset
from mapmyworld.diagnosis.sample import odometry_yaw, take_sample
from mapmyworld.geometry import Array
from mapmyworld.geometry.planar import matrix_to_planar
from mapmyworld.geometry.rigid import between
from mapmyworld.map_figures import tracked_path
from mapmyworld.sensing.plan import Plan
from mapmyworld.types import Frame, LogSource, MapStore


def diagnose(log: LogSource, plan: Plan, config: Config) -> tuple[Finding, ...]:
    """What the sensors of a log report about one another, from its first minutes of motion."""
    frames = take_sample(log, plan, config.sensing)
    framed = [frame for frame in frames if frame.images]
    findings = list(laser_findings(frames, plan, config.registration))
    if framed:
        from mapmyworld.diagnosis.cameras import camera_clock, camera_findings

        odometry = [frame.odom_from_base for frame in framed]
        findings += camera_findings(odometry, framed.__getitem__, plan, config)
        findings += camera_clock(framed, plan, frames[0].stamp_ns)
    return tuple(findings)


def diagnose_tracked(store: MapStore, plan: Plan, config: Config) -> tuple[Finding, ...]:
    """A tracked log's sensors compared: along the whole path, and by some nodes' images.

    Scans followed the odometry closely where they said nothing themselves, so a fault shows
    smaller than it is where walls are missing.
    """
    return (*_motion_findings(store, plan), *_camera_findings(store, plan, config))


def _motion_findings(store: MapStore, plan: Plan) -> Iterator[Finding]:
    """Laser against odometry; a robot that was followed by its odometry indicates nothing."""
    frames = store.tracked_frames()
    if plan.scan is None or frames.odom_from_base is None or len(frames.stamps_ns) < 2:
        return
    first_ns = int(frames.stamps_ns[0])
    clock = odometry_yaw(plan, first_ns)
    if clock is None:
        return
    moves = _steps(tracked_path(store.nodes(), frames))
    yield from distance_scale(_steps(frames.odom_from_base), moves)
    times = np.asarray((frames.stamps_ns - first_ns) * 1e-9, np.float64)
    offset = time_offset(("laser", "odometry"), times[:-1], times[1:], moves[:, 2], clock)
    if offset is not None:
        yield offset


def _steps(poses: Array) -> Array:
    """Motion (N - 1, 3) from each pose (N, 4, 4) to the next as x, y, yaw."""
    return np.asarray(matrix_to_planar(between(poses[:-1], poses[1:])))


def _camera_findings(store: MapStore, plan: Plan, config: Config) -> Iterator[Finding]:
    nodes = store.nodes()
    if plan.camera is None or not nodes:
        return
    from mapmyworld.diagnosis.cameras import camera_findings

    def frame_at(index: int) -> Frame:
        """What the map kept of a node's frame, to be looked at once more."""
        node = nodes[index]
        data = store.node_data(node.id)
        return Frame(node.stamp_ns, node.odom_from_base, data.scan, data.images)

    yield from camera_findings([node.odom_from_base for node in nodes], frame_at, plan, config)
