"""Foxglove's messages as typed values, from objects with their fields as attributes.

The same fields come in protobuf, JSON and ROS 2 clothes (https://docs.foxglove.dev/docs/sdk/schemas).
Images, calibrations and poses have the fields of ROS's messages, and are read as those.
"""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

from formats.logs.message_fields import (
    field,
    header_of,
    matrix_of,
    motion_of,
    octets_of,
    pose_of,
    singles,
    singles_of,
    stamp_of,
    xyz,
)
from formats.logs.point_clouds import cloud_cells, cloud_points
from formats.logs.ros_decoders import camera_info, image, image_compressed, pose
from mapmyworld.types import (
    LaserScanMessage,
    Message,
    MessageKind,
    OdometryMessage,
    PointCloudMessage,
    TransformsMessage,
    TransformStamped,
)

# foxglove.PackedElementField.NumericType -> sensor_msgs/PointField.datatype.
_DATATYPES = {1: 2, 2: 1, 3: 4, 4: 3, 5: 6, 6: 5, 7: 7, 8: 8}


def laser_scan(value: Any) -> LaserScanMessage:
    """A sweep; its own pose turns it about z (a shift cannot be said in our terms)."""
    ranges = singles_of(value, "ranges")
    start, end = float(field(value, "start_angle", 0.0)), float(field(value, "end_angle", 0.0))
    at = pose_of(value)
    turn = math.atan2(at[1, 0], at[0, 0])
    return LaserScanMessage(
        *header_of(value),
        start + turn,
        (end - start) / max(len(ranges) - 1, 1),
        0.0,
        0.0,
        0.0,
        math.inf,
        ranges,
        singles_of(value, "intensities"),
    )


def _transform(value: Any) -> TransformStamped:
    return TransformStamped(
        stamp_of(value),
        field(value, "parent_frame_id", ""),
        field(value, "child_frame_id", ""),
        motion_of(field(value, "translation"), field(value, "rotation")),
    )


def frame_transforms(value: Any) -> TransformsMessage:
    """Several transforms, none of them static."""
    found: Sequence[Any] = field(value, "transforms", ())
    return TransformsMessage(tuple(_transform(item) for item in found), static=False)


def odometry(value: Any) -> OdometryMessage:
    """A pose with its covariance, and the velocity."""
    velocity = field(value, "linear_velocity"), field(value, "angular_velocity")
    return OdometryMessage(
        *header_of(value),
        field(value, "body_frame_id", ""),
        pose_of(value),
        matrix_of(value, "pose_covariance", 6, 6),
        np.array(xyz(velocity[0]) + xyz(velocity[1])),
        matrix_of(value, "velocity_covariance", 6, 6),
    )


def point_cloud(value: Any) -> PointCloudMessage:
    """Points moved by the cloud's own pose, so that they stand in `frame_id`."""
    data, step = octets_of(value, "data"), int(field(value, "point_stride", 0))
    if step <= 0:
        raise ValueError("a point cloud without a stride")
    fields = [
        (
            str(field(item, "name", "")),
            int(field(item, "offset", 0)),
            _DATATYPES.get(int(field(item, "type", 0)), 0),
        )
        for item in field(value, "fields", ())
    ]
    points, colours = cloud_points(cloud_cells(fields, data, len(data) // step, 1, step, 0))
    at = pose_of(value)
    if not np.array_equal(at, np.eye(4)):
        points = singles(points @ at[:3, :3].T + at[:3, 3])
    return PointCloudMessage(*header_of(value), points, colours)


# By the name that follows "foxglove." or "foxglove_msgs/msg/".
CONVERTERS: dict[str, tuple[MessageKind, Callable[[Any], Message]]] = {
    "LaserScan": (MessageKind.LASER_SCAN, laser_scan),
    "CompressedImage": (MessageKind.IMAGE, image_compressed),
    "RawImage": (MessageKind.IMAGE, image),
    "CameraCalibration": (MessageKind.CAMERA_INFO, camera_info),
    "FrameTransform": (
        MessageKind.TRANSFORMS,
        lambda value: TransformsMessage((_transform(value),), static=False),
    ),
    "FrameTransforms": (MessageKind.TRANSFORMS, frame_transforms),
    "PoseInFrame": (MessageKind.POSE, pose),
    "Odometry": (MessageKind.ODOMETRY, odometry),
    "PointCloud": (MessageKind.POINT_CLOUD, point_cloud),
}


def foxglove_name(type_name: str) -> str:
    """The bare name of a Foxglove type; empty for any other."""
    found = re.fullmatch(r"(?:foxglove\.|foxglove_msgs(?:/msg/|\.))(.*)", type_name, re.DOTALL)
    return found[1] if found else ""
