"""What a node keeps, as the messages that its sensors would have sent."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from formats.database.sweep_messages import message_from_scan
from mapmyworld.geometry.planar import planar_to_matrix
from mapmyworld.types import (
    ImageMessage,
    Message,
    MessageKind,
    Node,
    NodeData,
    OdometryMessage,
    PointCloudMessage,
    PoseMessage,
    RawMessage,
    RgbdImage,
    TransformsMessage,
    TransformStamped,
)

_BASE, _ODOM, _LASER = "base_link", "odom", "laser"
TYPES = {
    MessageKind.TRANSFORMS: "tf2_msgs/msg/TFMessage",
    MessageKind.ODOMETRY: "nav_msgs/msg/Odometry",
    MessageKind.POSE: "geometry_msgs/msg/PoseWithCovarianceStamped",
    MessageKind.CAMERA_INFO: "sensor_msgs/msg/CameraInfo",
    MessageKind.IMAGE: "sensor_msgs/msg/Image",
    MessageKind.GPS: "sensor_msgs/msg/NavSatFix",
    MessageKind.LASER_SCAN: "sensor_msgs/msg/LaserScan",
    MessageKind.POINT_CLOUD: "sensor_msgs/msg/PointCloud2",
}


@dataclass(frozen=True, slots=True)
class Moment:
    """A tracked frame: its node, where it was, and whether it is that node itself."""

    index: int
    stamp_ns: int
    node: Node
    odom_from_base: NDArray[np.float64]
    """(4, 4)."""
    is_node: bool


def messages_at(
    moment: Moment, data: NodeData, mounts: dict[str, NDArray[np.float64]]
) -> Iterator[RawMessage]:
    """Everything of one moment.

    `mounts`, sensor frame -> base_from_sensor (4, 4), remembers which were reported already.
    """
    fresh = {name: at for name, at in _mounts(data).items() if name not in mounts}
    if fresh:
        mounts |= fresh
        yield _raw("/tf_static", MessageKind.TRANSFORMS, moment, lambda: _static(moment, fresh))
    yield _raw("/odom", MessageKind.ODOMETRY, moment, lambda: _odometry(moment))
    if moment.is_node and moment.node.ground_truth is not None:
        yield _raw("/ground_truth", MessageKind.POSE, moment, lambda: _truth(moment))
    fix = moment.node.gps
    if moment.is_node and fix is not None:
        yield _raw("/gps/fix", MessageKind.GPS, moment, lambda: fix)
    for number, image in enumerate(data.images):
        yield from _camera_messages(moment, number, image)
    scan, cloud = data.scan, data.cloud
    if scan is not None:
        yield _raw(
            "/scan",
            MessageKind.LASER_SCAN,
            moment,
            lambda: message_from_scan(scan, moment.stamp_ns, _LASER),
        )
    if cloud is not None:
        yield _raw(
            "/points",
            MessageKind.POINT_CLOUD,
            moment,
            lambda: PointCloudMessage(moment.stamp_ns, _BASE, cloud, None),
        )


def _raw(
    topic: str, kind: MessageKind, moment: Moment, decode: Callable[[], Message]
) -> RawMessage:
    return RawMessage(topic, kind, moment.stamp_ns, moment.stamp_ns, decode)


def _mounts(data: NodeData) -> dict[str, NDArray[np.float64]]:
    """Sensor frame -> base_from_sensor."""
    mounts = {
        _camera_frame(i): image.camera.base_from_camera for i, image in enumerate(data.images)
    }
    if data.scan is not None:
        mounts[_LASER] = planar_to_matrix(data.scan.origin)
    return mounts


def _static(moment: Moment, mounts: dict[str, NDArray[np.float64]]) -> TransformsMessage:
    return TransformsMessage(
        tuple(TransformStamped(moment.stamp_ns, _BASE, name, at) for name, at in mounts.items()),
        static=True,
    )


def _odometry(moment: Moment) -> OdometryMessage:
    unknown = np.zeros((6, 6))
    pose, twist = moment.odom_from_base, np.zeros(6)
    return OdometryMessage(moment.stamp_ns, _ODOM, _BASE, pose, unknown, twist, unknown)


def _truth(moment: Moment) -> PoseMessage:
    truth = moment.node.ground_truth
    assert truth is not None
    return PoseMessage(moment.stamp_ns, "world", truth, np.zeros((6, 6)))


def _camera_frame(number: int) -> str:
    return "camera_optical" if number == 0 else f"camera_{number}_optical"


def _camera_messages(moment: Moment, number: int, image: RgbdImage) -> Iterator[RawMessage]:
    """Info, colour and depth of one camera; the second and later have topics of their own."""
    space = "/camera" if number == 0 else f"/camera_{number}"
    frame, model = _camera_frame(number), image.camera
    stamp = image.colour or image.depth
    at = moment.stamp_ns if stamp is None else stamp.stamp_ns
    yield _raw(
        f"{space}/rgb/camera_info",
        MessageKind.CAMERA_INFO,
        moment,
        lambda: model.info(at, frame),
    )
    for kind, picture in (("rgb", image.colour), ("depth", image.depth)):
        if picture is not None:
            yield _picture(f"{space}/{kind}/image", moment, picture, frame)


def _picture(topic: str, moment: Moment, picture: ImageMessage, frame: str) -> RawMessage:
    message = replace(picture, frame_id=frame)
    kind = MessageKind.IMAGE
    return RawMessage(topic, kind, moment.stamp_ns, picture.stamp_ns, lambda: message)
