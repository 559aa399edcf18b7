"""Odometry that stands still and then catches up in one step, is reset, or loses some way."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from mapmyworld.geometry import Array
from mapmyworld.geometry.rigid import between, interpolate, invert
from mapmyworld.geometry.rotations import rotation_angle
from mapmyworld.sensing.motion import RecordedMotion

_RARE = 0.99  # quantile of the log's own speeds and intervals: what exceeds it is seldom
_SLOW = 0.25  # quantile of the same that is a slow one
_FEWEST = 50  # steps from which speeds are known
_GRAVITY = 9.81  # m/s^2
_RESET = 5.0, 10.0  # m, and times its own speed, that no robot goes from one pose to the next


def without_stalls(motion: RecordedMotion) -> tuple[RecordedMotion, int]:
    """The motion with its stalls interpolated, and how many there were.

    A stall repeats a pose to the last bit; the step after it is faster than the robot usually is.
    So much of the stall is interpolated as it needed for it, had it gone rather slowly.
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
    ends = np.flatnonzero(~stands[1:] & stands[:-1]) + 1
    slow, median = np.maximum(np.quantile(speeds[:, usual], (_SLOW, 0.5), axis=1), 1e-9)
    longer = (moved[:, ends].T / median).argmax(axis=1)  # by its way or by its turn
    moved = moved[longer, ends]
    needed = np.minimum(moved / slow[longer], seconds.sum())
    since = stamps[ends + 1] - (1e9 * needed).astype(np.int64)
    last_still = np.searchsorted(stamps, since, "right") - 1
    begins = np.maximum.accumulate(np.where(stands, 0, np.arange(1, len(stands) + 1)))
    firsts = begins[ends - 1]
    # What follows a silence may repeat a pose of before: nothing shows when the stall began.
    silent = np.append(np.inf, seconds)[firsts] > np.quantile(seconds, _RARE)
    begins = np.maximum(np.where(silent & (firsts > 0), firsts - 1, firsts), last_still)
    interpolated = np.zeros(len(poses), np.bool_)
    is_stall = (moved > median[longer] * seconds[ends]) & (begins < ends)
    for begin, end in zip(begins[is_stall].tolist(), ends[is_stall].tolist(), strict=True):
        inside = slice(begin + 1, end + 1)
        interpolated[inside] = True
        span = max(int(stamps[end + 1] - stamps[begin]), 1)
        share = (stamps[inside] - stamps[begin]) / span
        poses[inside] = interpolate(poses[begin], poses[end + 1], share)
    return motion.with_poses(poses, interpolated), int(np.count_nonzero(is_stall))


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
    fastest = np.quantile(speeds[usual], _RARE)
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


def without_losses(motion: RecordedMotion) -> tuple[RecordedMotion, int]:
    """The motion with what was lost in silences filled in, and how many silences lost some.

    A computer that hangs misses what its wheels report. Motion is lost where the robot drove before
    and after the silence, and would have had to brake harder for its little way than tyres hold.
    It goes on there as before and after, and the poses that follow continue from that.
    """
    if len(motion) < _FEWEST or not motion.is_sorted:
        return motion, 0
    poses, stamps = motion.poses_at(slice(None)), motion.stamps_ns
    continued, interpolated, found = poses.copy(), np.zeros(len(poses), np.bool_), 0
    for begin, end in _lossy_silences(poses, stamps):
        lasts = stamps[end] - stamps[begin]
        around = motion.at_many(np.array([stamps[begin] - lasts, stamps[end] + lasts]))
        if around is None:
            continue
        step = interpolate(between(around[0], poses[begin]), between(poses[end], around[1]), 0.5)
        inside = slice(begin + 1, end + 1)
        share = (stamps[inside] - stamps[begin]) / lasts
        continued[end:] = continued[begin] @ step @ between(poses[end], poses[end:])
        continued[inside] = interpolate(continued[begin], continued[end], share)
        interpolated[inside], found = True, found + 1
    return motion.with_poses(continued, interpolated), found


def _lossy_silences(poses: Array, stamps_ns: NDArray[np.int64]) -> list[tuple[int, int]]:
    """The poses, of (N, 4, 4) at `stamps_ns` (N,), between which odometry was silent and lost some
    way: the last one before, and the last of those that had to wait and come all at once after.
    """
    intervals = np.diff(stamps_ns)
    late = np.quantile(intervals, _RARE)
    begins = np.flatnonzero(intervals > late)
    soon = stamps_ns[begins + 1] + round(intervals.mean())
    ends = stamps_ns.searchsorted(soon, "right") - 1
    silence = stamps_ns[ends] - stamps_ns[begins]
    steps = np.linalg.norm(np.diff(poses[:, :3, 3], axis=0), axis=1)
    way = np.concatenate([[0.0], steps.cumsum()])
    before = way[begins] - np.interp(stamps_ns[begins] - silence, stamps_ns, way)
    after = np.interp(stamps_ns[ends] + silence, stamps_ns, way) - way[ends]
    driven = np.minimum(before, after)
    braking = _GRAVITY * (0.5e-9 * silence) ** 2  # at most, to a stand and up again
    lost = driven - (way[ends] - way[begins]) > braking + driven * late / silence
    return list(zip(begins[lost].tolist(), ends[lost].tolist(), strict=True))
