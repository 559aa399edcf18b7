"""Our typed messages as standard ROS ones, ready for rosbags to serialise in either format."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray
from rosbags.typesys.store import Typestore

from formats.ros_poses import exact_quaternion
from mapmyworld.errors import LogError
from mapmyworld.types import (
    CameraInfoMessage,
    ImageMessage,
    ImuMessage,
    LaserScanMessage,
    Message,
    OdometryMessage,
    PointCloudMessage,
    PoseMessage,
    TextMessage,
    TransformsMessage,
)

_FLOAT32 = 7  # sensor_msgs/PointField


class RosMessages:
    """Builds messages of one type store: ROS 1's or ROS 2's."""

    def __init__(self, store: Typestore, *, is_ros1: bool) -> None:
        self._store, self._is_ros1 = store, is_ros1

    def type_name(self, message: Message) -> str:
        """The ROS type that carries the message."""
        if isinstance(message, ImageMessage) and message.encoded is not None:
            return "sensor_msgs/msg/CompressedImage"
        return _BUILDERS[type(message)][0]

    def build(self, message: Message) -> object:
        """The message as an object of `type_name`."""
        name = self.type_name(message)
        if name == "sensor_msgs/msg/CompressedImage":
            return _compressed(self, message)
        return _BUILDERS[type(message)][1](self, message)

    def make(self, type_name: str, *values: Any) -> Any:
        """A message object of this version of ROS."""
        return self._store.types[type_name](*values)

    def header(self, stamp_ns: int, frame_id: str) -> Any:
        """A std_msgs/Header."""
        stamp = self.make("builtin_interfaces/msg/Time", *divmod(stamp_ns, 1_000_000_000))
        sequence = (0,) if self._is_ros1 else ()
        return self.make("std_msgs/msg/Header", *sequence, stamp, frame_id)

    def pose(self, matrix: NDArray[np.float64]) -> Any:
        """A geometry_msgs/Pose of (4, 4)."""
        return self.make(
            "geometry_msgs/msg/Pose",
            self.make("geometry_msgs/msg/Point", *matrix[:3, 3].tolist()),
            self.quaternion(matrix),
        )

    def quaternion(self, matrix: NDArray[np.float64]) -> Any:
        """The rotation of a pose (4, 4)."""
        return self.make("geometry_msgs/msg/Quaternion", *exact_quaternion(matrix[:3, :3]))

    def vector(self, values: NDArray[np.float64]) -> Any:
        """A geometry_msgs/Vector3 of (3,)."""
        return self.make("geometry_msgs/msg/Vector3", *values.tolist())

    def pose_with_covariance(
        self, matrix: NDArray[np.float64], covariance: NDArray[np.float64]
    ) -> Any:
        """A geometry_msgs/PoseWithCovariance of (4, 4) and (6, 6), translation first."""
        return self.make(
            "geometry_msgs/msg/PoseWithCovariance", self.pose(matrix), _flat(covariance)
        )


def _flat(values: NDArray[np.float64]) -> NDArray[np.float64]:
    return np.ascontiguousarray(values, np.float64).reshape(-1)


def _laser_scan(ros: RosMessages, m: LaserScanMessage) -> object:
    last = m.angle_min + m.angle_increment * max(len(m.ranges) - 1, 0)
    return ros.make(
        "sensor_msgs/msg/LaserScan",
        ros.header(m.stamp_ns, m.frame_id),
        m.angle_min,
        last,
        m.angle_increment,
        m.time_increment,
        m.scan_time,
        m.range_min,
        m.range_max,
        np.ascontiguousarray(m.ranges, np.float32),
        np.ascontiguousarray(m.intensities, np.float32),
    )


def _odometry(ros: RosMessages, m: OdometryMessage) -> object:
    twist = ros.make("geometry_msgs/msg/Twist", ros.vector(m.twist[:3]), ros.vector(m.twist[3:]))
    return ros.make(
        "nav_msgs/msg/Odometry",
        ros.header(m.stamp_ns, m.frame_id),
        m.child_frame_id,
        ros.pose_with_covariance(m.pose, m.pose_covariance),
        ros.make("geometry_msgs/msg/TwistWithCovariance", twist, _flat(m.twist_covariance)),
    )


def _imu(ros: RosMessages, m: ImuMessage) -> object:
    unknown = np.zeros(9)
    no_orientation = unknown.copy()
    no_orientation[0] = -1.0  # sensor_msgs/Imu: "no orientation estimate"
    known = m.orientation is not None
    values = m.orientation.tolist() if m.orientation is not None else [0.0, 0.0, 0.0, 1.0]
    return ros.make(
        "sensor_msgs/msg/Imu",
        ros.header(m.stamp_ns, m.frame_id),
        ros.make("geometry_msgs/msg/Quaternion", *values),
        unknown if known else no_orientation,
        ros.vector(m.angular_velocity),
        unknown,
        ros.vector(m.linear_acceleration),
        unknown,
    )


def _transforms(ros: RosMessages, m: TransformsMessage) -> object:
    stamped = [
        ros.make(
            "geometry_msgs/msg/TransformStamped",
            ros.header(t.stamp_ns, t.parent),
            t.child,
            ros.make(
                "geometry_msgs/msg/Transform",
                ros.vector(t.parent_from_child[:3, 3]),
                ros.quaternion(t.parent_from_child),
            ),
        )
        for t in m.transforms
    ]
    return ros.make("tf2_msgs/msg/TFMessage", stamped)


def _pose(ros: RosMessages, m: PoseMessage) -> object:
    return ros.make(
        "geometry_msgs/msg/PoseWithCovarianceStamped",
        ros.header(m.stamp_ns, m.frame_id),
        ros.pose_with_covariance(m.pose, m.covariance),
    )


def _text(ros: RosMessages, m: TextMessage) -> object:
    return ros.make("std_msgs/msg/String", m.text)


def _camera_info(ros: RosMessages, m: CameraInfoMessage) -> object:
    whole = ros.make("sensor_msgs/msg/RegionOfInterest", 0, 0, 0, 0, False)
    return ros.make(
        "sensor_msgs/msg/CameraInfo",
        ros.header(m.stamp_ns, m.frame_id),
        m.height,
        m.width,
        m.distortion_model,
        _flat(m.distortion),
        _flat(m.intrinsics),
        _flat(m.rectification),
        _flat(m.projection),
        0,
        0,
        whole,
    )


def _image(ros: RosMessages, m: ImageMessage) -> object:
    """Raw pixels: colour as rgb8, grey as mono8, depth as 32FC1 metres or 16UC1 millimetres."""
    pixels: NDArray[Any] = m.pixels()
    encoding = "rgb8" if pixels.ndim == 3 else "mono8"
    if m.is_depth:
        encoding = "32FC1" if m.encoding.upper() == "32FC1" else "16UC1"
        if encoding == "16UC1":
            pixels = np.round(np.clip(pixels * 1000.0, 0, 65535)).astype(np.uint16)
    height, width = pixels.shape[:2]
    data = np.ascontiguousarray(pixels).view(np.uint8).reshape(-1)
    return ros.make(
        "sensor_msgs/msg/Image",
        ros.header(m.stamp_ns, m.frame_id),
        height,
        width,
        encoding,
        0,
        len(data) // max(height, 1),
        data,
    )


def _compressed(ros: RosMessages, m: Message) -> object:
    """The JPEG or PNG file as it is; depth as compressedDepth (a header, then the PNG)."""
    if not isinstance(m, ImageMessage) or m.encoded is None:
        raise LogError("an image without its file cannot be written as a compressed one")
    data, described = m.encoded, "jpeg"
    if m.encoded.startswith(b"\x89PNG"):
        described = "png"
    if m.is_depth:
        data, described = bytes(12) + m.encoded, "16UC1; compressedDepth png"
    return ros.make(
        "sensor_msgs/msg/CompressedImage",
        ros.header(m.stamp_ns, m.frame_id),
        described,
        np.frombuffer(data, np.uint8),
    )


def _point_cloud(ros: RosMessages, m: PointCloudMessage) -> object:
    names = ["x", "y", "z"] + (["rgb"] if m.colours is not None else [])
    cells = np.zeros((len(m.points), len(names)), np.float32)
    cells[:, :3] = m.points
    if m.colours is not None:
        red, green, blue = m.colours.astype(np.uint32).T
        cells[:, 3] = ((red << 16) | (green << 8) | blue).astype(np.uint32).view(np.float32)
    fields = [
        ros.make("sensor_msgs/msg/PointField", name, 4 * i, _FLOAT32, 1)
        for i, name in enumerate(names)
    ]
    step = 4 * len(names)
    return ros.make(
        "sensor_msgs/msg/PointCloud2",
        ros.header(m.stamp_ns, m.frame_id),
        1,
        len(cells),
        fields,
        False,
        step,
        step * len(cells),
        cells.view(np.uint8).reshape(-1),
        True,
    )


_BUILDERS: dict[type, tuple[str, Callable[[RosMessages, Any], object]]] = {
    LaserScanMessage: ("sensor_msgs/msg/LaserScan", _laser_scan),
    OdometryMessage: ("nav_msgs/msg/Odometry", _odometry),
    ImuMessage: ("sensor_msgs/msg/Imu", _imu),
    TransformsMessage: ("tf2_msgs/msg/TFMessage", _transforms),
    PoseMessage: ("geometry_msgs/msg/PoseWithCovarianceStamped", _pose),
    TextMessage: ("std_msgs/msg/String", _text),
    CameraInfoMessage: ("sensor_msgs/msg/CameraInfo", _camera_info),
    ImageMessage: ("sensor_msgs/msg/Image", _image),
    PointCloudMessage: ("sensor_msgs/msg/PointCloud2", _point_cloud),
}
