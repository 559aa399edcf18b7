"""Odometry that stands still and then catches up in one step, or is reset."""

from __future__ import annotations

from itertools import pairwise

import numpy as np

from mapmyworld.geometry.rigid import between, interpolate, invert
from mapmyworld.geometry.rotations import rotation_angle
from mapmyworld.sensing.motion import RecordedMotion

_FASTEST = 0.99  # quantile of the log's own speeds beyond which a step is none of the robot's
_FEWEST = 50  # steps from which speeds are known
_RESET = 5.0, 10.0  # m, and times its own speed, that no robot goes from one pose to the next


def without_stalls(motion: RecordedMotion) -> tuple[RecordedMotion, int]:
    """The motion with its stalls interpolated, and how many there were.

    A stall repeats a pose to the last bit; the step after it is faster than the robot ever is. At
    its usual speed the robot needed so long for it: so much of the stall is interpolated.
    """
    if len(motion) < _FEWEST or not motion.is_sorted:
        return motion, 0
    poses, stamps = motion.poses_at(slice(None)), motion.stamps_ns
    seconds = np.diff(stamps) * 1e-9
    steps = between(poses[:-1], poses[1:])
    moved = np.stack([np.linalg.norm(steps[:, :3, 3], axis=1), rotation_angle(steps)])
    stands = (poses[1:] == poses[:-1]).all(axis=(1, 2))
    speeds = moved / np.maximum(seconds, 1e-9)
    usual = ~stands & ~np.concatenate([[True], stands[:-1]]) & (seconds > 0.0)
    if np.count_nonzero(usual) < _FEWEST:
        return motion, 0
    fastest, median = np.quantile(speeds[:, usual], [_FASTEST, 0.5], axis=1)
    jumps = np.flatnonzero(
        ~stands[1:] & stands[:-1] & (speeds[:, 1:] > fastest[:, None]).any(axis=0)
    ) + 1  # fmt: skip
    interpolated = np.zeros(len(poses), np.bool_)
    begins = np.maximum.accumulate(np.where(stands, 0, np.arange(1, len(stands) + 1)))
    for jump in jumps.tolist():
        needed = int(1e9 * (moved[:, jump] / np.maximum(median, 1e-9)).max())
        begin = max(
            int(begins[jump - 1]),
            int(np.searchsorted(stamps, stamps[jump + 1] - needed, "right")) - 1,
        )
        inside = slice(begin + 1, jump + 1)
        interpolated[inside] = True
        span = max(int(stamps[jump + 1] - stamps[begin]), 1)
        share = (stamps[inside] - stamps[begin]) / span
        poses[inside] = interpolate(poses[begin], poses[jump + 1], share)
    return motion.with_poses(poses, interpolated), len(jumps)


def without_resets(motion: RecordedMotion) -> tuple[RecordedMotion, int]:
    """The motion without its resets, and how many there were.

    A driver that is started again begins at the origin, a filter is corrected: the poses after
    that continue from the pose before it, as if the robot had stood meanwhile.
    """
    if len(motion) < _FEWEST or not motion.is_sorted:
        return motion, 0
    poses, seconds = motion.poses_at(slice(None)), np.diff(motion.stamps_ns) * 1e-9
    metres = np.linalg.norm(np.diff(poses[:, :3, 3], axis=0), axis=1)
    speeds = metres / np.maximum(seconds, 1e-9)
    usual = (metres > 0.0) & (seconds > 0.0)
    if np.count_nonzero(usual) < _FEWEST:
        return motion, 0
    fastest = np.quantile(speeds[usual], _FASTEST)
    resets = np.flatnonzero((metres > _RESET[0]) & (speeds > _RESET[1] * fastest)) + 1
    if not len(resets):
        return motion, 0
    continued, before_from_after = poses.copy(), np.eye(4)
    for reset, end in pairwise([*resets.tolist(), len(poses)]):
        before_from_after = before_from_after @ poses[reset - 1] @ invert(poses[reset])
        continued[reset:end] = before_from_after @ poses[reset:end]
    interpolated = np.zeros(len(poses), np.bool_)
    interpolated[resets] = True
    return motion.with_poses(continued, interpolated), len(resets)
