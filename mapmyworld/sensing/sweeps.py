"""A recorded laser message becomes a `Scan`: points of the base frame, motion taken out."""

from __future__ import annotations

import functools
import math

import numpy as np
from numpy.typing import NDArray

from mapmyworld.errors import LogError
from mapmyworld.geometry import Array
from mapmyworld.geometry.planar import matrix_to_planar
from mapmyworld.geometry.rigid import between
from mapmyworld.sensing.motion import RecordedMotion
from mapmyworld.types import LaserScanMessage, Scan

_KNOTS = 8  # poses looked up along a sweep; beams between them move in straight lines


def scan_from_message(
    message: LaserScanMessage,
    base_from_lidar: NDArray[np.float64],
    motion: RecordedMotion | None,
    seconds_a_radian: float = 0.0,
) -> Scan:
    """The sweep in the base frame at the stamp of its first beam.

    `base_from_lidar` is (4, 4). Beams follow each other as the message says, or by
    `seconds_a_radian` where that is given. Those with NaN, or closer than `range_min`, count
    neither as returns nor as missing, which are infinite, beyond the maximum, or zero. Raises
    `LogError` where the sweep does not say where its beams went.
    """
    from mapmyworld.kernels.sweep_points import carried_on, returned_points

    if not (math.isfinite(message.angle_min) and math.isfinite(message.angle_increment)):
        raise LogError("a scan whose angles are not finite")
    ranges, (low, high) = message.ranges, _limits(message)
    empty = (ranges >= high) | (ranges == 0.0)
    angles, ways = _beams(message.angle_min, message.angle_increment, len(ranges))
    returned, points = returned_points(ranges, low, high, ways, base_from_lidar)
    if motion is not None and seconds_a_radian:
        seconds = np.abs(angles - angles[0])[returned] * seconds_a_radian
        carried_on(points, motion.velocity(message.stamp_ns), seconds)
    elif motion is not None and message.time_increment > 0 and len(points) > 1:
        points = _without_motion(message, returned, points, motion)
    origin = matrix_to_planar(base_from_lidar)
    upward = np.copysign(1.0, base_from_lidar[2, 2])  # -1 where it hangs upside down
    with np.errstate(over="ignore"):  # of angles that no laser has
        missing = (upward * angles[empty] + origin[2]).astype(np.float32)
    return Scan(
        points=np.ascontiguousarray(points[:, :2], np.float32),
        origin=origin,
        missing=missing,
        range_max=float(message.range_max) if message.range_max > 0 else np.inf,
        angle_increment=abs(float(message.angle_increment)),
    )


@functools.lru_cache(1)  # a laser has the same beams, sweep after sweep
def _beams(first: float, step: float, count: int) -> tuple[Array, Array]:
    """Angles (N,) of so many beams and their directions (N, 2) in the laser's plane."""
    angles = np.asarray(first + step * np.arange(count), np.float64)
    return angles, np.stack([np.cos(angles), np.sin(angles)], axis=-1)


def valid_ranges(scan: LaserScanMessage) -> NDArray[np.bool_]:
    """(N,) which beams came back from something: finite, above the minimum, below the maximum."""
    low, high = _limits(scan)
    return np.asarray((scan.ranges > low) & (scan.ranges < high))


def _limits(scan: LaserScanMessage) -> tuple[np.float32, np.float32]:
    """Between which ranges are measurements, m: 0 and infinite where a limit is no number."""
    high = scan.range_max if scan.range_max > 0 else np.inf
    return np.float32(max(0.0, scan.range_min)), np.float32(high)


def _without_motion(
    message: LaserScanMessage, beams: NDArray[np.int64], points: Array, motion: RecordedMotion
) -> Array:
    """The points (N, 3), moved from where the base was at their beams to where it was at first."""
    from mapmyworld.kernels.recorded_motion import moved_between_knots

    step_ns = message.time_increment * 1e9 * (len(message.ranges) - 1) / (_KNOTS - 1)
    poses = motion.at_many(message.stamp_ns + (np.arange(_KNOTS) * step_ns).astype(np.int64))
    if poses is None:
        return points
    places = beams.astype(np.float64) * (message.time_increment * 1e9 / step_ns)
    return moved_between_knots(points, places, between(poses[0], poses))
