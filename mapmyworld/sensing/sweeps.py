"""A recorded laser message becomes a `Scan`: points of the base frame, motion taken out."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from mapmyworld.geometry import Array, between, matrix_to_planar
from mapmyworld.sensing.motion import RecordedMotion
from mapmyworld.sensing.plan_lasers import valid_ranges
from mapmyworld.types import LaserScanMessage, Scan

_KNOTS = 8  # poses looked up along a sweep; beams between them move in straight lines


def scan_from_message(
    message: LaserScanMessage,
    base_from_lidar: NDArray[np.float64],
    motion: RecordedMotion | None,
) -> Scan:
    """The sweep in the base frame at the stamp of its first beam.

    Beams with NaN, or closer than `range_min`, count neither as returns nor as missing.
    """
    count = len(message.ranges)
    bearings = message.angle_min + message.angle_increment * np.arange(count)
    valid = valid_ranges(message)
    ranges = message.ranges[valid].astype(np.float64)
    flat = np.stack(
        [ranges * np.cos(bearings[valid]), ranges * np.sin(bearings[valid]), np.zeros(len(ranges))],
        axis=-1,
    )
    points = flat @ base_from_lidar[:3, :3].T + base_from_lidar[:3, 3]
    if motion is not None and message.time_increment > 0 and len(points) > 1:
        points = _without_motion(message, np.flatnonzero(valid), points, motion)
    origin = matrix_to_planar(base_from_lidar)
    upside_down = base_from_lidar[2, 2] < 0
    missing = bearings[_missing(message)] * (-1.0 if upside_down else 1.0) + origin[2]
    return Scan(
        points=np.ascontiguousarray(points[:, :2], np.float32),
        origin=origin,
        missing=missing.astype(np.float32),
        range_max=float(message.range_max) if message.range_max > 0 else np.inf,
        angle_increment=abs(float(message.angle_increment)),
    )


def _missing(message: LaserScanMessage) -> NDArray[np.bool_]:
    """(N,) beams that came back with nothing: infinite, beyond the maximum, or zero."""
    ranges = message.ranges
    limit = message.range_max if message.range_max > 0 else np.inf
    with np.errstate(invalid="ignore"):
        return np.asarray((ranges >= limit) | np.isposinf(ranges) | (ranges == 0))


def _without_motion(
    message: LaserScanMessage, beams: NDArray[np.int64], points: Array, motion: RecordedMotion
) -> Array:
    """Points (N, 3) moved from the base at each beam's time to the base at the first beam's."""
    step_ns = message.time_increment * 1e9 * (len(message.ranges) - 1) / (_KNOTS - 1)
    poses = motion.at_many(message.stamp_ns + (np.arange(_KNOTS) * step_ns).astype(np.int64))
    if poses is None:
        return points
    moved = between(poses[0], poses)
    place = np.clip(beams * (message.time_increment * 1e9 / step_ns), 0.0, _KNOTS - 1.0)
    lower = np.minimum(place.astype(np.int64), _KNOTS - 2)
    share = (place - lower)[:, None]
    rotation, translation = moved[:, :3, :3], moved[:, :3, 3]
    at_lower = np.einsum("nij,nj->ni", rotation[lower], points) + translation[lower]
    at_upper = np.einsum("nij,nj->ni", rotation[lower + 1], points) + translation[lower + 1]
    return np.asarray((1.0 - share) * at_lower + share * at_upper)
