"""Lines of a CARMEN log as typed values: readings, poses and exact stamps.

The format is CARMEN's own: one message a line, `NAME fields... ipc_timestamp host logger_timestamp`
(http://carmen.sourceforge.net/logger_playback.html). Bytes throughout: a log is not always UTF-8.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from formats.logs.message_fields import singles
from formats.logs.poses import planar_pose
from mapmyworld.types import LaserScanMessage, OdometryMessage, PoseMessage

_NONE = np.zeros(0, np.float32)
_MAX_BEAMS = 100_000  # more in one line is damage, not a lidar
FRONT_LASERS = (b"FLASER", b"ROBOTLASER1", b"RAWLASER1")
REAR_LASERS = (b"RLASER", b"ROBOTLASER2", b"RAWLASER2")
BARE_LASERS = (b"FLASER", b"RLASER")
"""Whose lines have the readings and poses alone."""
RAW_LASERS = frozenset({b"RAWLASER1", b"RAWLASER2"})
"""Whose lines indicate no pose."""
LASER_FRAMES = dict.fromkeys(FRONT_LASERS, "laser") | dict.fromkeys(REAR_LASERS, "laser_rear")
LASER_TOPICS = dict.fromkeys(FRONT_LASERS, "/scan") | dict.fromkeys(REAR_LASERS, "/scan_rear")


@dataclass(frozen=True, slots=True, eq=False)
class LaserRecord:
    """One sweep, and the poses at which it was taken where its line indicates them."""

    ranges: NDArray[np.float32]
    """(N,) m."""
    intensities: NDArray[np.float32]
    """(N,) or (0,)."""
    angle_min: float
    """rad."""
    angle_increment: float
    """rad."""
    range_max: float
    """m; 0 = the record does not say."""
    odom_from_laser: list[float]
    """x, y, yaw, or nothing."""
    odom_from_base: list[float]
    """x, y, yaw, or nothing."""


def flaser_angles(count: int) -> tuple[float, float]:
    """First bearing and step, radians, of a sweep of `count` beams over 180 degrees.

    An odd count includes both ends (181, 361); an even one leaves the last end out (180, 360).
    """
    steps = count - 1 if count % 2 else count
    return -math.pi / 2, math.pi / max(steps, 1)


def _count(field: bytes, fields: list[bytes]) -> int:
    count = int(field)
    if not 0 <= count <= min(_MAX_BEAMS, len(fields)):
        raise ValueError(f"{count} readings in a line of {len(fields)} fields")
    return count


def parse_flaser(fields: list[bytes]) -> LaserRecord:
    """FLASER or RLASER: no angles of its own. ValueError where the line is damaged."""
    count = _count(fields[1], fields)
    if len(fields) != count + 11:
        raise ValueError(f"{len(fields)} fields where {count} readings need {count + 11}")
    poses = _finite(fields[count + 2 : count + 8])
    ranges = singles(fields[2 : count + 2])
    return LaserRecord(ranges, _NONE, *flaser_angles(count), 0.0, poses[:3], poses[3:])


def parse_robotlaser(fields: list[bytes]) -> LaserRecord:
    """ROBOTLASER or RAWLASER: start angle, step and largest range stand in every record.

    What follows the readings is alike up to the remissions; then ROBOTLASER has two poses and
    five fields more, RAWLASER none.
    """
    start, _, step, range_max = _finite(fields[2:6])
    count = _count(fields[8], fields)
    remissions = _count(fields[count + 9], fields)
    tail = count + 10 + remissions
    reported = 0 if fields[0] in RAW_LASERS else 11
    if len(fields) != tail + reported + 3:
        raise ValueError(f"{len(fields)} fields where {tail + reported + 3} are announced")
    poses = _finite(fields[tail : tail + min(reported, 6)])
    intensities = singles(fields[count + 10 : tail]) if remissions == count else _NONE
    ranges = singles(fields[9 : count + 9])
    return LaserRecord(ranges, intensities, start, step, range_max, poses[:3], poses[3:])


def _finite(fields: list[bytes]) -> list[float]:
    values = [float(field) for field in fields]
    if not all(map(math.isfinite, values)):
        raise ValueError("a pose or angle that is not finite")
    return values


def parse_numbers(fields: list[bytes]) -> list[float]:
    """The five numbers that ODOM and TRUEPOS lines begin with. ValueError where it is damaged."""
    if len(fields) < 10:
        raise ValueError(f"{len(fields)} fields where 10 are needed")
    return _finite(fields[1:6])


PARSERS: dict[bytes, Callable[[list[bytes]], LaserRecord | list[float]]] = {
    **dict.fromkeys((b"ODOM", b"TRUEPOS"), parse_numbers),
    **dict.fromkeys(LASER_TOPICS, parse_robotlaser),
    **dict.fromkeys(BARE_LASERS, parse_flaser),
}
"""By the kind of a line; they raise ValueError or IndexError where it is damaged."""


def scan_of_record(
    record: LaserRecord, stamp_ns: int, frame_id: str, range_max: float
) -> LaserScanMessage:
    """The sweep of a laser line; `range_max` serves where the record itself has none."""
    numbers = [record.angle_min, record.angle_increment, record.range_max or range_max]
    start, step, reach = singles(numbers).tolist()
    return LaserScanMessage(
        stamp_ns, frame_id, start, step, 0.0, 0.0, 0.0, reach, record.ranges, record.intensities
    )


_UNKNOWN_COVARIANCE = np.zeros((6, 6))
_UNKNOWN_COVARIANCE.setflags(write=False)


def _odometry(stamp_ns: int, pose: Sequence[float], twist: NDArray[np.float64]) -> OdometryMessage:
    matrix = planar_pose(*pose)
    return OdometryMessage(
        stamp_ns, "odom", "base_link", matrix, _UNKNOWN_COVARIANCE, twist, _UNKNOWN_COVARIANCE
    )


def odometry_of_record(record: LaserRecord, stamp_ns: int) -> OdometryMessage:
    """Where the robot was, by its wheels, when the sweep was taken."""
    return _odometry(stamp_ns, record.odom_from_base, np.zeros(6))


def odometry_from_odom_line(numbers: list[float], stamp_ns: int) -> OdometryMessage:
    """ODOM x y theta tv rv accel: pose and speed."""
    *pose, forward, turning = numbers
    return _odometry(stamp_ns, pose, np.array([forward, 0.0, 0.0, 0.0, 0.0, turning]))


def pose_from_truepos_line(numbers: list[float], stamp_ns: int) -> PoseMessage:
    """TRUEPOS true_x true_y true_theta odom_x odom_y odom_theta: the simulator's true pose."""
    return PoseMessage(stamp_ns, "map", planar_pose(*numbers[:3]), _UNKNOWN_COVARIANCE)
