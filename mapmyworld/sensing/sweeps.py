"""A recorded laser message becomes a `Scan`: points of the base frame, motion taken out."""

from __future__ import annotations

import functools
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mapmyworld.errors import LogError
from mapmyworld.geometry import Array
from mapmyworld.geometry.planar import matrix_to_planar
from mapmyworld.geometry.rigid import between, transform_points
from mapmyworld.sensing.motion import RecordedMotion
from mapmyworld.types import LaserScanMessage, Scan

_KNOTS = 8  # poses looked up along a sweep; beams between them move in straight lines


def scan_from_message(
    message: LaserScanMessage,
    base_from_lidar: NDArray[np.float64],
    motion: RecordedMotion | None,
) -> Scan:
    """The sweep in the base frame at the stamp of its first beam.

    `base_from_lidar` is (4, 4). Beams with NaN, or closer than `range_min`, count neither as
    returns nor as missing. Raises `LogError` where the sweep does not say where its beams went.
    """
    if not np.isfinite([message.angle_min, message.angle_increment]).all():
        raise LogError("a scan whose angles are not finite")
    beams = _beams(
        message.angle_min, message.angle_increment, len(message.ranges), base_from_lidar.tobytes()
    )
    points, returned, empty = _sorted_beams(message, beams, base_from_lidar[:3, 3])
    if motion is not None and message.time_increment > 0 and len(points) > 1:
        points = _without_motion(message, returned, points, motion)
    return Scan(
        points=np.ascontiguousarray(points[:, :2], np.float32),
        origin=beams.origin,
        missing=beams.bearings[empty],
        range_max=float(message.range_max) if message.range_max > 0 else np.inf,
        angle_increment=abs(float(message.angle_increment)),
    )


@dataclass(frozen=True, slots=True, eq=False)
class _Beams:
    """Where the beams of a laser point, sweep after sweep."""

    directions: Array
    """(N, 3) in the base frame."""
    bearings: NDArray[np.float32]
    """(N,) relative to the base's x axis."""
    origin: Array
    """(3,) base_from_lidar as x, y, yaw."""


@functools.lru_cache(maxsize=16)
def _beams(angle_min: float, increment: float, count: int, mount: bytes) -> _Beams:
    base_from_lidar = np.frombuffer(mount).reshape(4, 4)
    angles = angle_min + increment * np.arange(count)
    flat = np.stack([np.cos(angles), np.sin(angles), np.zeros(count)], axis=-1)
    origin = matrix_to_planar(base_from_lidar)
    upside_down = base_from_lidar[2, 2] < 0
    bearings = angles * (-1.0 if upside_down else 1.0) + origin[2]
    with np.errstate(over="ignore"):  # of angles that no laser has
        return _Beams(flat @ base_from_lidar[:3, :3].T, bearings.astype(np.float32), origin)


def _sorted_beams(
    message: LaserScanMessage, beams: _Beams, origin: Array
) -> tuple[Array, NDArray[np.int64], NDArray[np.int64]]:
    """Points (M, 3) of the beams that came back, numbers (M,) of these, and of those with nothing:
    infinite, beyond the maximum, or zero.
    """
    ranges = np.asarray(message.ranges, np.float32)
    low = np.float32(max(0.0, message.range_min))  # 0 where the limit is no number
    high = np.float32(message.range_max if message.range_max > 0 else np.inf)
    with np.errstate(invalid="ignore"):
        valid = np.isfinite(ranges) & (ranges > low) & (ranges < high)
        empty = ~valid & ((ranges >= high) | np.isposinf(ranges) | (ranges == 0.0))
    returned = np.flatnonzero(valid)
    points = ranges[returned, None] * beams.directions[returned] + origin
    return points, returned, np.flatnonzero(empty)


def _without_motion(
    message: LaserScanMessage, beams: NDArray[np.int64], points: Array, motion: RecordedMotion
) -> Array:
    """The points (N, 3), moved from where the base was at their beams to where it was at first."""
    step_ns = message.time_increment * 1e9 * (len(message.ranges) - 1) / (_KNOTS - 1)
    poses = motion.at_many(message.stamp_ns + (np.arange(_KNOTS) * step_ns).astype(np.int64))
    if poses is None:
        return points
    places = beams.astype(np.float64) * (message.time_increment * 1e9 / step_ns)
    return moved_between_knots(points, places, between(poses[0], poses))


def moved_between_knots(points: Array, places: Array, moved: Array) -> Array:
    """Points (N, 3) moved by the motion at their places (N,), counted in knots, (N, 3).

    `moved` (K, 4, 4) is the motion at the knots; between two they move in straight lines.
    """
    places = np.clip(places, 0.0, len(moved) - 1)
    lower = np.minimum(places.astype(np.int64), len(moved) - 2)
    share, each = (places - lower)[:, None], np.arange(len(points))
    at_knots = transform_points(moved, points)
    return np.asarray((1.0 - share) * at_knots[lower, each] + share * at_knots[lower + 1, each])
