"""Lines of a CARMEN log as typed values: readings, poses and exact stamps.

The format is CARMEN's own: one message a line, `NAME fields... ipc_timestamp host logger_timestamp`
(http://carmen.sourceforge.net/logger_playback.html). Bytes throughout: a log is not always UTF-8.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from formats.logs.message_fields import single, singles
from formats.logs.poses import planar_pose
from mapmyworld.types import LaserScanMessage, OdometryMessage, PoseMessage

_MAX_BEAMS = 100_000  # more in one line is damage, not a lidar
FRONT_LASERS = (b"FLASER", b"ROBOTLASER1", b"RAWLASER1")
REAR_LASERS = (b"RLASER", b"ROBOTLASER2", b"RAWLASER2")
RAW_LASERS = frozenset({b"RAWLASER1", b"RAWLASER2"})
"""Whose lines indicate no pose."""
LASER_FRAMES = dict.fromkeys(FRONT_LASERS, "laser") | dict.fromkeys(REAR_LASERS, "laser_rear")
LASER_TOPICS = dict.fromkeys(FRONT_LASERS, "/scan") | dict.fromkeys(REAR_LASERS, "/scan_rear")


@dataclass(frozen=True, slots=True, eq=False)
class LaserRecord:
    """One sweep, and the poses at which it was taken where its line indicates them."""

    ranges: NDArray[np.float64]
    """(N,) m."""
    intensities: NDArray[np.float32]
    """(N,) or (0,)."""
    angle_min: float
    """rad."""
    angle_increment: float
    """rad."""
    range_max: float
    """m; 0 = the record does not say."""
    odom_from_laser: NDArray[np.float64]
    """(3,) x, y, yaw, or (0,)."""
    odom_from_base: NDArray[np.float64]
    """(3,) x, y, yaw, or (0,)."""


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


def _floats(fields: list[bytes]) -> NDArray[np.float64]:
    return np.array(fields, np.float64)


def parse_flaser(line: bytes) -> LaserRecord:
    """FLASER or RLASER: no angles of its own. ValueError where the line is damaged."""
    fields = line.split()
    count = _count(fields[1], fields)
    if len(fields) != count + 11:
        raise ValueError(f"{len(fields)} fields where {count} readings need {count + 11}")
    numbers = _floats(fields[2 : count + 8])
    poses = _finite(numbers[count:])
    return LaserRecord(
        numbers[:count],
        np.zeros(0, np.float32),
        *flaser_angles(count),
        0.0,
        poses[:3],
        poses[3:],
    )


def parse_robotlaser(line: bytes) -> LaserRecord:
    """ROBOTLASER or RAWLASER: start angle, step and largest range stand in every record.

    What follows the readings is alike up to the remissions; then ROBOTLASER has two poses and
    five fields more, RAWLASER none.
    """
    fields = line.split()
    start, _, step, range_max = _finite(_floats(fields[2:6]))
    count = _count(fields[8], fields)
    remissions = _count(fields[count + 9], fields)
    tail = count + 10 + remissions
    reported = 0 if line.startswith(b"RAWLASER") else 11
    if len(fields) != tail + reported + 3:
        raise ValueError(f"{len(fields)} fields where {tail + reported + 3} are announced")
    poses = _finite(_floats(fields[tail : tail + min(reported, 6)]))
    intensities = _floats(fields[count + 10 : tail]) if remissions == count else np.zeros(0)
    return LaserRecord(
        _floats(fields[9 : count + 9]),
        singles(intensities),
        float(start),
        float(step),
        float(range_max),
        poses[:3],
        poses[3:],
    )


def _finite(values: NDArray[np.float64]) -> NDArray[np.float64]:
    if not np.isfinite(values).all():
        raise ValueError("a pose or angle that is not finite")
    return values


def parse_laser(line: bytes) -> LaserRecord:
    """A laser line of any kind; IndexError or ValueError where it is damaged."""
    return parse_robotlaser(line) if line.startswith((b"RO", b"RA")) else parse_flaser(line)


def scan_from_line(line: bytes, stamp_ns: int, frame_id: str, range_max: float) -> LaserScanMessage:
    """The sweep of a laser line; `range_max` serves where the record itself has none."""
    record = parse_laser(line)
    return LaserScanMessage(
        stamp_ns,
        frame_id,
        single(record.angle_min),
        single(record.angle_increment),
        0.0,
        0.0,
        0.0,
        single(record.range_max or range_max),
        singles(record.ranges),
        record.intensities,
    )


_UNKNOWN_COVARIANCE = np.zeros((6, 6))
_UNKNOWN_COVARIANCE.setflags(write=False)


def _odometry(
    stamp_ns: int, pose: NDArray[np.float64], twist: NDArray[np.float64]
) -> OdometryMessage:
    matrix = planar_pose(*pose.tolist())
    return OdometryMessage(
        stamp_ns, "odom", "base_link", matrix, _UNKNOWN_COVARIANCE, twist, _UNKNOWN_COVARIANCE
    )


def odometry_from_laser_line(line: bytes, stamp_ns: int) -> OdometryMessage:
    """Where the robot was, by its wheels, when the sweep of this line was taken."""
    # Counted from the end, so that the readings need no parsing.
    last = 9 if line.startswith(b"ROBOTLASER") else 4
    x, y, yaw = _finite(_floats(line.rsplit(None, last + 2)[1:4]))
    return _odometry(stamp_ns, np.array([x, y, yaw]), np.zeros(6))


def odometry_from_odom_line(line: bytes, stamp_ns: int) -> OdometryMessage:
    """ODOM x y theta tv rv accel: pose and speed."""
    x, y, yaw, forward, turning = _finite(_floats(line.split()[1:6]))
    twist = np.array([forward, 0.0, 0.0, 0.0, 0.0, turning])
    return _odometry(stamp_ns, np.array([x, y, yaw]), twist)


def pose_from_truepos_line(line: bytes, stamp_ns: int) -> PoseMessage:
    """TRUEPOS true_x true_y true_theta odom_x odom_y odom_theta: the simulator's true pose."""
    pose = _finite(_floats(line.split()[1:4]))
    return PoseMessage(stamp_ns, "map", planar_pose(*pose.tolist()), _UNKNOWN_COVARIANCE)
