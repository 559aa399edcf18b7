"""Frames of a log in which the robot moves, as many as the comparisons need."""

from __future__ import annotations

import numpy as np

from mapmyworld.config import SensingConfig
from mapmyworld.geometry import Array
from mapmyworld.geometry.rigid import between
from mapmyworld.geometry.rotations import rotation_angle
from mapmyworld.sensing.plan import Plan
from mapmyworld.sensing.synchronise import read_frames
from mapmyworld.types import Frame, LogSource

_ENOUGH = 600  # pairs of neighbouring frames between which the robot moved
_MOVED = 0.005  # m, or rad, by the odometry


def odometry_yaw(plan: Plan, first_ns: int) -> tuple[Array, Array] | None:
    """Times in s since `first_ns`, ascending, and the unwrapped headings in rad, (N,) both."""
    source = plan.odometry
    if source is None or len(source.motion) < 2:
        return None
    stamps_ns = np.sort(source.motion.stamps_ns)
    times = np.asarray((stamps_ns - first_ns) * 1e-9, np.float64)
    return times, source.motion.in_plane(stamps_ns)[:, 2]


def take_sample(log: LogSource, plan: Plan, config: SensingConfig) -> list[Frame]:
    """Frames from the start of the log, in its order, until enough motion was seen, or all."""
    frames, moving = list[Frame](), 0
    for frame in read_frames(log, plan, config):
        if frames and _moved(frames[-1], frame):
            moving += 1
        frames.append(frame)
        if moving >= _ENOUGH:
            break
    return frames


def _moved(before: Frame, now: Frame) -> bool:
    if before.odom_from_base is None or now.odom_from_base is None:
        return True
    step = between(before.odom_from_base, now.odom_from_base)
    return bool(np.linalg.norm(step[:3, 3]) > _MOVED or rotation_angle(step) > _MOVED)
