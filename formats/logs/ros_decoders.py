"""Standard ROS messages as typed values, from the objects that rosbags makes: one function a type.

A field that the definition of a recording lacks is zero or empty.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from formats.logs.image_pixels import compressed_image, raw_pixels
from formats.logs.message_fields import (
    doubles_of,
    field,
    header_of,
    matrix_of,
    motion_of,
    octets_of,
    pose_of,
    singles_of,
    xyz,
)
from formats.logs.point_clouds import cloud_cells, cloud_points
from mapmyworld.types import (
    CameraInfoMessage,
    GpsMessage,
    ImageMessage,
    ImuMessage,
    LaserScanMessage,
    Message,
    MessageKind,
    OdometryMessage,
    PointCloudMessage,
    PoseMessage,
    TextMessage,
    TransformsMessage,
    TransformStamped,
)

Decoder = Callable[[Any], Message]
_NO_FIX = -1  # of a receiver of GPS
_ERROR = 10.0  # m, where the receiver does not indicate it
_MOST_FIELDS = 1000  # of a point; more is damage
_RATES = ("angular_velocity", "linear_acceleration")
SCAN_NUMBERS = (
    "angle_min",
    "angle_increment",
    "time_increment",
    "scan_time",
    "range_min",
    "range_max",
)


def laser_scan(value: Any) -> LaserScanMessage:
    """A planar sweep."""
    return _scan(value, singles_of(value, "ranges"), singles_of(value, "intensities"))


def multi_echo_laser_scan(value: Any) -> LaserScanMessage:
    """The first echo of each beam; infinite where there is none."""
    ranges = _first_echoes(field(value, "ranges", ()), math.inf)
    return _scan(value, ranges, _first_echoes(field(value, "intensities", ()), 0.0))


def _first_echoes(beams: Sequence[Any], missing: float) -> NDArray[np.float32]:
    return np.array([beam.echoes[0] if len(beam.echoes) else missing for beam in beams], np.float32)


def _scan(
    value: Any, ranges: NDArray[np.float32], intensities: NDArray[np.float32]
) -> LaserScanMessage:
    numbers = [float(field(value, name, 0.0)) for name in SCAN_NUMBERS]
    first, step, beam_time, scan_time, nearest, farthest = numbers
    stamp, frame = header_of(value)
    return LaserScanMessage(
        stamp, frame, first, step, beam_time, scan_time, nearest, farthest, ranges, intensities
    )


def odometry(value: Any) -> OdometryMessage:
    """A pose with its covariance, and the velocity."""
    pose, twist = field(value, "pose"), field(value, "twist")
    speed = field(twist, "twist")
    return OdometryMessage(
        *header_of(value),
        field(value, "child_frame_id", ""),
        pose_of(pose),
        matrix_of(pose, "covariance", 6, 6),
        np.array(xyz(field(speed, "linear")) + xyz(field(speed, "angular"))),
        matrix_of(twist, "covariance", 6, 6),
    )


def imu(value: Any) -> ImuMessage:
    """An inertial sample; its orientation is None where the device indicates that it has none."""
    turn = field(value, "orientation")
    orientation = np.array([*xyz(turn), float(field(turn, "w", 0.0))])
    # A first covariance of -1 says "no orientation"; so does a quaternion that was never set.
    denied = matrix_of(value, "orientation_covariance", 3, 3)[0, 0] == -1.0
    known = not denied and bool(orientation.any())
    rates = (np.array(xyz(field(value, name))) for name in _RATES)
    return ImuMessage(*header_of(value), orientation if known else None, *rates)


def transforms(value: Any) -> TransformsMessage:
    """Transforms of tf, static by their topic."""
    return TransformsMessage(tuple(map(_transform, field(value, "transforms", ()))), static=False)


def _transform(value: Any) -> TransformStamped:
    motion = field(value, "transform")
    matrix = motion_of(field(motion, "translation"), field(motion, "rotation"))
    return TransformStamped(*header_of(value), field(value, "child_frame_id", ""), matrix)


def camera_info(value: Any) -> CameraInfoMessage:
    """Intrinsics of a camera."""
    return CameraInfoMessage(
        *header_of(value),
        int(field(value, "width", 0)),
        int(field(value, "height", 0)),
        field(value, "distortion_model", ""),
        doubles_of(value, "D"),
        matrix_of(value, "K", 3, 3),
        matrix_of(value, "R", 3, 3),
        matrix_of(value, "P", 3, 4),
    )


def image(value: Any) -> ImageMessage:
    """Pixels as they are, decoded when asked for."""
    encoding, data = field(value, "encoding", ""), octets_of(value, "data")
    width, height, step = (int(field(value, name, 0)) for name in ("width", "height", "step"))
    big_endian = bool(field(value, "is_bigendian", False))
    decode = partial(raw_pixels, encoding, width, height, step, data, big_endian)
    return ImageMessage(*header_of(value), encoding, width, height, decode)


def image_compressed(value: Any) -> ImageMessage:
    """A JPEG, PNG, WebP or compressedDepth image, decoded when asked for."""
    data = bytes(octets_of(value, "data"))
    return compressed_image(*header_of(value), field(value, "format", ""), data)


def point_cloud(value: Any) -> PointCloudMessage:
    """Points, with their colours where they have some; rows that are not finite left out."""
    if len(value.fields) > _MOST_FIELDS:
        raise ValueError(f"{len(value.fields)} fields")
    size = value.width, value.height, value.point_step, value.row_step
    fields = [(f.name, f.offset, f.datatype) for f in value.fields]
    cells = cloud_cells(fields, memoryview(value.data), *size, bool(value.is_bigendian))
    points, colours = cloud_points(cells)
    return PointCloudMessage(*header_of(value), points, colours)


def pose(value: Any) -> PoseMessage:
    """A pose without covariance."""
    return PoseMessage(*header_of(value), pose_of(value), np.zeros((6, 6)))


def pose_with_covariance(value: Any) -> PoseMessage:
    """A pose with its covariance."""
    found = field(value, "pose")
    return PoseMessage(*header_of(value), pose_of(found), matrix_of(found, "covariance", 6, 6))


def text(value: Any) -> TextMessage:
    """A string, which has no time of its own."""
    return TextMessage(0, value.data)


def nav_sat_fix(value: Any) -> GpsMessage:
    """Position with its largest standard deviation; NaN where the receiver has no fix."""
    names = ("latitude", "longitude", "altitude")
    latitude, longitude, altitude = (float(field(value, name, math.nan)) for name in names)
    variance = float(matrix_of(value, "position_covariance", 3, 3).diagonal().max())
    is_known = field(value, "position_covariance_type", 0) != 0
    known = is_known and math.isfinite(variance) and variance > 0
    if field(field(value, "status"), "status", 0) == _NO_FIX:
        latitude = longitude = math.nan
    error = math.sqrt(variance) if known else _ERROR
    return GpsMessage(*header_of(value), latitude, longitude, altitude, error)


CONVERTERS: dict[str, tuple[MessageKind, Decoder]] = {
    "tf2_msgs/msg/TFMessage": (MessageKind.TRANSFORMS, transforms),
    "tf/msg/tfMessage": (MessageKind.TRANSFORMS, transforms),
    "std_msgs/msg/String": (MessageKind.TEXT, text),
    "sensor_msgs/msg/LaserScan": (MessageKind.LASER_SCAN, laser_scan),
    "sensor_msgs/msg/MultiEchoLaserScan": (MessageKind.LASER_SCAN, multi_echo_laser_scan),
    "nav_msgs/msg/Odometry": (MessageKind.ODOMETRY, odometry),
    "sensor_msgs/msg/Imu": (MessageKind.IMU, imu),
    "sensor_msgs/msg/CameraInfo": (MessageKind.CAMERA_INFO, camera_info),
    "sensor_msgs/msg/Image": (MessageKind.IMAGE, image),
    "sensor_msgs/msg/CompressedImage": (MessageKind.IMAGE, image_compressed),
    "sensor_msgs/msg/PointCloud2": (MessageKind.POINT_CLOUD, point_cloud),
    "geometry_msgs/msg/PoseStamped": (MessageKind.POSE, pose),
    "geometry_msgs/msg/PoseWithCovarianceStamped": (MessageKind.POSE, pose_with_covariance),
    "sensor_msgs/msg/NavSatFix": (MessageKind.GPS, nav_sat_fix),
}
