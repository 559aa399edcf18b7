"""Standard ROS messages, of either wire format, as typed values: one function a type.

Each takes the wire format and the message's bytes, and raises ValueError, struct.error or
IndexError where they do not hold what the type needs.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import cast

import numpy as np
from numpy.typing import NDArray

from formats.logs.channels import Payload
from formats.logs.environment_decoders import nav_sat_fix, reading_decoder
from formats.logs.image_pixels import compressed_image, raw_image
from formats.logs.point_clouds import PointField, cloud_points
from formats.logs.poses import pose_matrix
from formats.logs.wire import Wire
from mapmyworld.types import (
    CameraInfoMessage,
    ImageMessage,
    ImuMessage,
    LaserScanMessage,
    Message,
    MessageKind,
    OdometryMessage,
    PointCloudMessage,
    PoseMessage,
    Quantity,
    TextMessage,
    TransformsMessage,
    TransformStamped,
)

Floats = NDArray[np.float64]
Decoder = Callable[[Wire, Payload], Message]
_MAX_ITEMS = 1_000_000  # transforms or echoes in one message; more is damage


def _doubles(wire: Wire, data: Payload, position: int, count: int) -> tuple[Floats, int]:
    found, end = wire.array(data, position, "f8", count)
    return cast(Floats, found), end


def _singles(wire: Wire, data: Payload, position: int) -> tuple[NDArray[np.float32], int]:
    found, end = wire.floats(data, position, "f4")
    return cast("NDArray[np.float32]", found), end


def laser_scan(wire: Wire, data: Payload) -> LaserScanMessage:
    """A planar sweep."""
    stamp, frame, position = wire.header(data, wire.start)
    numbers, position = wire.array(data, wire.align(position, 4), "f4", 7)
    ranges, position = _singles(wire, data, position)
    intensities, _ = _singles(wire, data, position)
    return _scan(stamp, frame, numbers, ranges, intensities)


def multi_echo_laser_scan(wire: Wire, data: Payload) -> LaserScanMessage:
    """The first echo of each beam; infinite where there is none."""
    stamp, frame, position = wire.header(data, wire.start)
    numbers, position = wire.array(data, wire.align(position, 4), "f4", 7)
    ranges, position = _first_echoes(wire, data, position, math.inf)
    intensities, _ = _first_echoes(wire, data, position, 0.0)
    return _scan(stamp, frame, numbers, ranges, intensities)


def _first_echoes(
    wire: Wire, data: Payload, position: int, missing: float
) -> tuple[NDArray[np.float32], int]:
    count, position = wire.u32(data, position)
    if count > _MAX_ITEMS:
        raise ValueError(f"{count} beams")
    first = np.full(count, missing, np.float32)
    for beam in range(count):
        echoes, position = _singles(wire, data, position)
        if len(echoes):
            first[beam] = echoes[0]
    return first, position


def _scan(
    stamp: int,
    frame: str,
    numbers: NDArray[np.generic],
    ranges: NDArray[np.float32],
    intensities: NDArray[np.float32],
) -> LaserScanMessage:
    first, _, step, beam_time, scan_time, nearest, farthest = numbers.tolist()
    return LaserScanMessage(
        stamp, frame, first, step, beam_time, scan_time, nearest, farthest, ranges, intensities
    )


def odometry(wire: Wire, data: Payload) -> OdometryMessage:
    """A pose with its covariance, and the velocity."""
    stamp, frame, position = wire.header(data, wire.start)
    child, position = wire.string(data, position)
    position = wire.align(position, 8)
    matrix = pose_matrix(wire.unpack_pose(data, position))
    values, _ = _doubles(wire, data, position + 56, 78)
    return OdometryMessage(
        stamp,
        frame,
        child,
        matrix,
        values[:36].reshape(6, 6),
        values[36:42],
        values[42:].reshape(6, 6),
    )


def imu(wire: Wire, data: Payload) -> ImuMessage:
    """An inertial sample; its orientation is None where the device indicates that it has none."""
    stamp, frame, position = wire.header(data, wire.start)
    values, _ = _doubles(wire, data, position, 37)
    # A first covariance of -1 says "no orientation"; so does a quaternion that was never set.
    known = values[4] != -1.0 and bool(values[:4].any())
    return ImuMessage(stamp, frame, values[:4] if known else None, values[13:16], values[25:28])


def transforms(wire: Wire, data: Payload, *, static: bool) -> TransformsMessage:
    """Transforms of tf, static or not by their topic."""
    count, position = wire.u32(data, wire.start)
    if count > _MAX_ITEMS:
        raise ValueError(f"{count} transforms")
    found = []
    for _ in range(count):
        stamp, parent, position = wire.header(data, position)
        child, position = wire.string(data, position)
        position = wire.align(position, 8)
        matrix = pose_matrix(wire.unpack_pose(data, position))
        found.append(TransformStamped(stamp, parent, child, matrix))
        position += 56
    return TransformsMessage(tuple(found), static)


def camera_info(wire: Wire, data: Payload) -> CameraInfoMessage:
    """Intrinsics of a camera."""
    stamp, frame, position = wire.header(data, wire.start)
    height, position = wire.u32(data, position)
    width, position = wire.u32(data, position)
    model, position = wire.string(data, position)
    distortion, position = wire.floats(data, position, "f8")
    values, _ = _doubles(wire, data, position, 30)
    return CameraInfoMessage(
        stamp,
        frame,
        width,
        height,
        model,
        cast(Floats, distortion),
        values[:9].reshape(3, 3),
        values[9:18].reshape(3, 3),
        values[18:].reshape(3, 4),
    )


def image(wire: Wire, data: Payload) -> ImageMessage:
    """Pixels as they are, decoded when asked for."""
    stamp, frame, position = wire.header(data, wire.start)
    height, position = wire.u32(data, position)
    width, position = wire.u32(data, position)
    encoding, position = wire.string(data, position)
    big_endian = bool(data[position])
    step, position = wire.u32(data, position + 1)
    length, position = wire.u32(data, position)
    if position + length > len(data):
        raise ValueError(f"{length} bytes of pixels announced, {len(data) - position} are there")
    return raw_image(stamp, frame, encoding, width, height, step, data, position, big_endian)


def image_compressed(wire: Wire, data: Payload) -> ImageMessage:
    """A JPEG, PNG, WebP or compressedDepth image, decoded when asked for."""
    stamp, frame, position = wire.header(data, wire.start)
    described, position = wire.string(data, position)
    payload, _ = wire.octets(data, position)
    return compressed_image(stamp, frame, described, payload)


def point_cloud(wire: Wire, data: Payload) -> PointCloudMessage:
    """Points, with their colours where they have some; rows that are not finite left out."""
    stamp, frame, position = wire.header(data, wire.start)
    height, position = wire.u32(data, position)
    width, position = wire.u32(data, position)
    count, position = wire.u32(data, position)
    if count > 1000:
        raise ValueError(f"{count} fields")
    fields = []
    for _ in range(count):
        name, position = wire.string(data, position)
        offset, position = wire.u32(data, position)
        datatype = data[position]
        repeated, position = wire.u32(data, position + 1)
        fields.append(PointField(name, offset, datatype, repeated))
    big_endian = bool(data[position])
    step, position = wire.u32(data, position + 1)
    row_step, position = wire.u32(data, position)
    payload, _ = wire.octets(data, position)
    points, colours = cloud_points(fields, payload, width, height, step, row_step, big_endian)
    return PointCloudMessage(stamp, frame, points, colours)


def pose(wire: Wire, data: Payload) -> PoseMessage:
    """A pose without covariance."""
    stamp, frame, position = wire.header(data, wire.start)
    values, _ = _doubles(wire, data, position, 7)
    return PoseMessage(stamp, frame, pose_matrix(values.tolist()), np.zeros((6, 6)))


def pose_with_covariance(wire: Wire, data: Payload) -> PoseMessage:
    """A pose with its covariance."""
    stamp, frame, position = wire.header(data, wire.start)
    values, _ = _doubles(wire, data, position, 43)
    return PoseMessage(stamp, frame, pose_matrix(values[:7].tolist()), values[7:].reshape(6, 6))


def text(wire: Wire, data: Payload, log_time_ns: int) -> TextMessage:
    """A string, whose time is that of the log."""
    return TextMessage(log_time_ns, wire.string(data, wire.start)[0])


# Types with a header, whose stamp can be read alone.
STAMPED: dict[str, tuple[MessageKind, Decoder]] = {
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
    **{
        f"sensor_msgs/msg/{name}": (MessageKind.READING, reading_decoder(quantity, scale))
        for name, quantity, scale in (
            ("Temperature", Quantity.TEMPERATURE, 1.0),
            ("FluidPressure", Quantity.PRESSURE, 0.01),  # Pa to hPa
            ("Illuminance", Quantity.LIGHT, 1.0),
            ("RelativeHumidity", Quantity.HUMIDITY, 100.0),  # share to percent
        )
    },
}
TRANSFORMS = frozenset({"tf2_msgs/msg/TFMessage", "tf/msg/tfMessage"})
TEXT = "std_msgs/msg/String"
