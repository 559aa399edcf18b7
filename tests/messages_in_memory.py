"""Messages for logs in memory, for tests of everything above the readers."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from mapmyworld.geometry.planar import planar_to_matrix
from mapmyworld.memory_log import MemoryLog as MemoryLog
from mapmyworld.types import (
    CameraInfoMessage,
    ImageMessage,
    LaserScanMessage,
    OdometryMessage,
    TransformsMessage,
    TransformStamped,
)


def scan_at(
    stamp_ns: int, ranges: np.ndarray | None = None, frame_id: str = "laser", **changes: float
) -> LaserScanMessage:
    """A half-circle sweep; all ranges 2 m unless given."""
    values = np.full(181, 2.0, np.float32) if ranges is None else ranges.astype(np.float32)
    settings = {
        "angle_min": -np.pi / 2,
        "angle_increment": np.pi / (len(values) - 1),
        "time_increment": 0.0,
        "scan_time": 0.1,
        "range_min": 0.1,
        "range_max": 10.0,
    } | changes
    return LaserScanMessage(
        stamp_ns=stamp_ns,
        frame_id=frame_id,
        ranges=values,
        intensities=np.zeros(0, np.float32),
        **settings,
    )


def odometry_at(
    stamp_ns: int,
    pose: Sequence[float],
    frame_id: str = "odom",
    child: str = "base_link",
) -> OdometryMessage:
    """A planar odometry message that indicates nothing about its covariance."""
    return OdometryMessage(
        stamp_ns=stamp_ns,
        frame_id=frame_id,
        child_frame_id=child,
        pose=planar_to_matrix(pose),
        pose_covariance=np.zeros((6, 6)),
        twist=np.zeros(6),
        twist_covariance=np.zeros((6, 6)),
    )


def transform(
    parent: str, child: str, pose: Sequence[float], stamp_ns: int = 0, *, static: bool = True
) -> TransformsMessage:
    """One planar transform."""
    moved = TransformStamped(stamp_ns, parent, child, planar_to_matrix(pose))
    return TransformsMessage((moved,), static)


def image_at(
    stamp_ns: int, encoding: str, size: tuple[int, int] = (64, 48), frame_id: str = "camera_optical"
) -> ImageMessage:
    """A blank image of this size (width, height)."""
    width, height = size
    depth = encoding in {"16UC1", "32FC1"}
    pixels = (
        np.ones((height, width), np.float32) if depth else np.zeros((height, width, 3), np.uint8)
    )
    return ImageMessage(stamp_ns, frame_id, encoding, width, height, lambda: pixels)


def camera_info_at(
    stamp_ns: int, size: tuple[int, int] = (64, 48), frame_id: str = "camera_optical"
) -> CameraInfoMessage:
    width, height = size
    k = np.array([[60.0, 0.0, width / 2], [0.0, 60.0, height / 2], [0.0, 0.0, 1.0]])
    projection = np.hstack([k, np.zeros((3, 1))])
    return CameraInfoMessage(
        stamp_ns, frame_id, width, height, "plumb_bob", np.zeros(5), k, np.eye(3), projection
    )
