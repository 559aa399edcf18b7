"""Foxglove's messages as typed values, from objects with their fields as attributes.

The same fields come in protobuf, JSON and ROS 2 clothes (https://docs.foxglove.dev/docs/sdk/schemas).
"""

from __future__ import annotations

import base64
import math
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

from formats.bounds import LATEST_NS
from formats.logs.image_pixels import compressed_image, raw_image
from formats.logs.message_fields import (
    doubles_of,
    field,
    matrix_of,
    motion_of,
    pose_of,
    singles_of,
    xyz,
)
from formats.logs.point_clouds import PointField, cloud_points
from formats.logs.singles import singles
from mapmyworld.types import (
    CameraInfoMessage,
    ImageMessage,
    LaserScanMessage,
    Message,
    MessageKind,
    OdometryMessage,
    PointCloudMessage,
    PoseMessage,
    TransformsMessage,
    TransformStamped,
)

# foxglove.PackedElementField.NumericType -> sensor_msgs/PointField.datatype.
_DATATYPES = {1: 2, 2: 1, 3: 4, 4: 3, 5: 6, 6: 5, 7: 7, 8: 8}
_NO_PIXELS = 0
_MODELS = {"plumb_bob", "rational_polynomial", "equidistant"}


def stamp_of(value: Any) -> int:
    """Nanoseconds of its Timestamp (protobuf), {sec, nsec} (JSON) or Time (ROS)."""
    time = field(value, "timestamp")
    seconds = field(time, "seconds", field(time, "sec", 0))
    fractions = (field(time, name) for name in ("nanos", "nsec", "nanosec"))
    rest = next((fraction for fraction in fractions if fraction is not None), 0)
    return min(max(int(seconds) * 1_000_000_000 + int(rest), 0), LATEST_NS)


def _octets(value: Any) -> bytes:
    """Bytes, which JSON holds in base64."""
    if isinstance(value, str):
        return base64.b64decode(value, validate=True)
    return bytes(value) if value is not None else b""


def laser_scan(value: Any) -> LaserScanMessage:
    """A sweep; its own pose turns it about z (a shift cannot be said in our terms)."""
    ranges = singles_of(value, "ranges")
    start, end = float(field(value, "start_angle", 0.0)), float(field(value, "end_angle", 0.0))
    pose = pose_of(value)
    turn = math.atan2(pose[1, 0], pose[0, 0])
    return LaserScanMessage(
        stamp_of(value),
        field(value, "frame_id", ""),
        start + turn,
        (end - start) / max(len(ranges) - 1, 1),
        0.0,
        0.0,
        0.0,
        math.inf,
        ranges,
        singles_of(value, "intensities"),
    )


def image_compressed(value: Any) -> ImageMessage:
    """A JPEG, PNG or WebP file, decoded when asked for."""
    data = _octets(field(value, "data"))
    described = field(value, "format", "")
    return compressed_image(stamp_of(value), field(value, "frame_id", ""), described, data)


def image_raw(value: Any) -> ImageMessage:
    """Pixels as they are, decoded when asked for."""
    return raw_image(
        stamp_of(value),
        field(value, "frame_id", ""),
        field(value, "encoding", ""),
        int(field(value, "width", _NO_PIXELS)),
        int(field(value, "height", _NO_PIXELS)),
        int(field(value, "step", 0)),
        _octets(field(value, "data")),
    )


def camera_calibration(value: Any) -> CameraInfoMessage:
    """Intrinsics; a model of distortion that nobody here knows is left out."""
    model = str(field(value, "distortion_model", ""))
    return CameraInfoMessage(
        stamp_of(value),
        field(value, "frame_id", ""),
        int(field(value, "width", 0)),
        int(field(value, "height", 0)),
        model if model in _MODELS else "",
        doubles_of(value, "D"),
        matrix_of(value, "K", 3, 3),
        matrix_of(value, "R", 3, 3),
        matrix_of(value, "P", 3, 4),
    )


def _transform(value: Any) -> TransformStamped:
    return TransformStamped(
        stamp_of(value),
        field(value, "parent_frame_id", ""),
        field(value, "child_frame_id", ""),
        motion_of(field(value, "translation"), field(value, "rotation")),
    )


def frame_transform(value: Any) -> TransformsMessage:
    """One transform."""
    return TransformsMessage((_transform(value),), static=False)


def frame_transforms(value: Any) -> TransformsMessage:
    """Several transforms, none of them static."""
    found: Sequence[Any] = field(value, "transforms", ())
    return TransformsMessage(tuple(_transform(item) for item in found), static=False)


def pose_in_frame(value: Any) -> PoseMessage:
    """A pose without covariance."""
    return PoseMessage(
        stamp_of(value), field(value, "frame_id", ""), pose_of(value), np.zeros((6, 6))
    )


def odometry(value: Any) -> OdometryMessage:
    """A pose with its covariance, and the velocity."""
    velocity = field(value, "linear_velocity"), field(value, "angular_velocity")
    return OdometryMessage(
        stamp_of(value),
        field(value, "frame_id", ""),
        field(value, "body_frame_id", ""),
        pose_of(value),
        matrix_of(value, "pose_covariance", 6, 6),
        np.array(xyz(velocity[0]) + xyz(velocity[1])),
        matrix_of(value, "velocity_covariance", 6, 6),
    )


def point_cloud(value: Any) -> PointCloudMessage:
    """Points moved by the cloud's own pose, so that they stand in `frame_id`."""
    data, step = _octets(field(value, "data")), int(field(value, "point_stride", 0))
    if step <= 0:
        raise ValueError("a point cloud without a stride")
    fields = [
        PointField(
            str(field(item, "name", "")),
            int(field(item, "offset", 0)),
            _DATATYPES.get(int(field(item, "type", 0)), 0),
        )
        for item in field(value, "fields", ())
    ]
    points, colours = cloud_points(fields, data, len(data) // step, 1, step, 0)
    pose = pose_of(value)
    if not np.array_equal(pose, np.eye(4)):
        points = singles(points @ pose[:3, :3].T + pose[:3, 3])
    return PointCloudMessage(stamp_of(value), field(value, "frame_id", ""), points, colours)


# By the name that follows "foxglove." or "foxglove_msgs/msg/".
CONVERTERS: dict[str, tuple[MessageKind, Callable[[Any], Message]]] = {
    "LaserScan": (MessageKind.LASER_SCAN, laser_scan),
    "CompressedImage": (MessageKind.IMAGE, image_compressed),
    "RawImage": (MessageKind.IMAGE, image_raw),
    "CameraCalibration": (MessageKind.CAMERA_INFO, camera_calibration),
    "FrameTransform": (MessageKind.TRANSFORMS, frame_transform),
    "FrameTransforms": (MessageKind.TRANSFORMS, frame_transforms),
    "PoseInFrame": (MessageKind.POSE, pose_in_frame),
    "Odometry": (MessageKind.ODOMETRY, odometry),
    "PointCloud": (MessageKind.POINT_CLOUD, point_cloud),
}


def foxglove_name(type_name: str) -> str:
    """The bare name of a Foxglove type; empty for any other."""
    for prefix in ("foxglove.", "foxglove_msgs/msg/", "foxglove_msgs."):
        if type_name.startswith(prefix):
            name = type_name[len(prefix) :]
            return name if name in CONVERTERS else ""
    return ""
