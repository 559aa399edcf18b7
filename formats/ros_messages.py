"""Our typed messages as standard ROS ones, ready for rosbags to serialise in either format.

A builder gives the fields that it knows, by their names; the others are zero or empty.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray
from rosbags.interfaces import Nodetype
from rosbags.typesys.store import Typestore

from formats.logs.ros_decoders import SCAN_NUMBERS
from mapmyworld.geometry.rotations import rotation_to_quaternion
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
)

Fields = Mapping[str, Any]
RosFields = tuple[str, Fields]
"""A ROS type, and the fields of a message of it."""
_FLOAT32 = 7  # sensor_msgs/PointField


def ros_message(message: Message | RosFields, store: Typestore) -> tuple[str, Any]:
    """The ROS type that carries the message, and the message as that type of the store's."""
    if isinstance(message, tuple):
        return message[0], _made(store, *message)
    name, build = _BUILDERS[type(message)]
    if isinstance(message, ImageMessage) and message.encoded is not None:
        name, build = "sensor_msgs/msg/CompressedImage", _compressed
    about = header(message.stamp_ns, getattr(message, "frame_id", ""))  # types without one lack it
    return name, _made(store, name, {"header": about, **build(message)})


def _made(store: Typestore, type_name: str, given: Fields) -> Any:
    values = {
        name: _value(store, field, given.get(name.lower()))  # ROS 1 has D, K, R and P
        for name, field in store.fielddefs[type_name][1]
    }
    return store.types[type_name](**values)


def _value(store: Typestore, field: Any, given: Any) -> Any:
    kind, what = field
    if kind == Nodetype.NAME:
        return _made(store, what, given or {})
    if kind == Nodetype.BASE:
        empty = "" if what[0] == "string" else 0
        return empty if given is None else given
    (inner, element), size = what
    if inner == Nodetype.NAME:
        return [_made(store, element, item) for item in given or ()]
    if given is None:
        return np.zeros(size, element[0])
    return np.ascontiguousarray(given, element[0]).reshape(-1)


def header(stamp_ns: int, frame_id: str) -> Fields:
    """A std_msgs/Header."""
    seconds, nanoseconds = divmod(stamp_ns, 1_000_000_000)
    return {"stamp": {"sec": seconds, "nanosec": nanoseconds}, "frame_id": frame_id}


def vector(values: NDArray[np.float64]) -> Fields:
    """A geometry_msgs/Vector3 or Point of (3,)."""
    return dict(zip("xyz", values.tolist(), strict=True))


def quaternion(matrix: NDArray[np.float64]) -> Fields:
    """The rotation of a pose (4, 4)."""
    return dict(zip("xyzw", exact_quaternion(matrix[:3, :3]), strict=True))


def pose_of(matrix: NDArray[np.float64]) -> Fields:
    """A geometry_msgs/Pose of (4, 4)."""
    return {"position": vector(matrix[:3, 3]), "orientation": quaternion(matrix)}


def pose_in_map(
    stamp_ns: int, pose: NDArray[np.float64], covariance: NDArray[np.float64]
) -> PoseMessage:
    """A pose (4, 4) in the map; its covariance (6, 6) has rotation first and its own axes.

    As geometry_msgs/PoseWithCovariance wants it: translation first, about the map's axes.
    """
    turn = np.zeros((6, 6))
    turn[:3, 3:] = turn[3:, :3] = pose[:3, :3]
    return PoseMessage(stamp_ns, "map", pose, turn @ covariance @ turn.T)


def _laser_scan(m: LaserScanMessage) -> Fields:
    numbers = {name: getattr(m, name) for name in SCAN_NUMBERS}
    return {
        **numbers,
        "angle_max": m.angle_min + m.angle_increment * max(len(m.ranges) - 1, 0),
        "ranges": m.ranges,
        "intensities": m.intensities,
    }


def _odometry(m: OdometryMessage) -> Fields:
    twist = {"linear": vector(m.twist[:3]), "angular": vector(m.twist[3:])}
    return {
        "child_frame_id": m.child_frame_id,
        "pose": {"pose": pose_of(m.pose), "covariance": m.pose_covariance},
        "twist": {"twist": twist, "covariance": m.twist_covariance},
    }


def _imu(m: ImuMessage) -> Fields:
    known = m.orientation is not None
    values = m.orientation.tolist() if m.orientation is not None else [0.0, 0.0, 0.0, 1.0]
    # sensor_msgs/Imu: a first covariance of -1 is "no orientation estimate".
    return {
        "orientation": dict(zip("xyzw", values, strict=True)),
        "orientation_covariance": None if known else [-1.0, *8 * [0.0]],
        "angular_velocity": vector(m.angular_velocity),
        "linear_acceleration": vector(m.linear_acceleration),
    }


def _transforms(m: TransformsMessage) -> Fields:
    stamped = []
    for t in m.transforms:
        moved, turned = vector(t.parent_from_child[:3, 3]), quaternion(t.parent_from_child)
        motion = {"translation": moved, "rotation": turned}
        about = header(t.stamp_ns, t.parent)
        stamped.append({"header": about, "child_frame_id": t.child, "transform": motion})
    return {"transforms": stamped}


def _pose(m: PoseMessage) -> Fields:
    return {"pose": {"pose": pose_of(m.pose), "covariance": m.covariance}}


def _gps(m: GpsMessage) -> Fields:
    """Without a fix the status is -1; the covariance is that of the error, in all directions."""
    return {
        "status": {"status": -1 if math.isnan(m.latitude) else 0},
        "latitude": m.latitude,
        "longitude": m.longitude,
        "altitude": m.altitude,
        "position_covariance": np.eye(3) * m.error**2,
        "position_covariance_type": 1,
    }


def _text(m: TextMessage) -> Fields:
    return {"data": m.text}


def _camera_info(m: CameraInfoMessage) -> Fields:
    return {
        "height": m.height,
        "width": m.width,
        "distortion_model": m.distortion_model,
        "d": m.distortion,
        "k": m.intrinsics,
        "r": m.rectification,
        "p": m.projection,
    }


def _image(m: ImageMessage) -> Fields:
    """Raw pixels: colour as rgb8, grey as mono8, depth as 32FC1 metres or 16UC1 millimetres."""
    pixels: NDArray[Any] = m.pixels()
    encoding = "rgb8" if pixels.ndim == 3 else "mono8"
    if m.is_depth:
        encoding = "32FC1" if m.encoding.upper() == "32FC1" else "16UC1"
        if encoding == "16UC1":
            pixels = np.round(np.clip(pixels * 1000.0, 0, 65535)).astype(np.uint16)
    height, width = pixels.shape[:2]
    data = np.ascontiguousarray(pixels).view(np.uint8).reshape(-1)
    return {
        "height": height,
        "width": width,
        "encoding": encoding,
        "step": len(data) // max(height, 1),
        "data": data,
    }


def _compressed(m: ImageMessage) -> Fields:
    """The JPEG or PNG file as it is; depth as compressedDepth (a header, then the PNG)."""
    data = m.encoded or b""
    described = "png" if data.startswith(b"\x89PNG") else "jpeg"
    if m.is_depth:
        data, described = bytes(12) + data, "16UC1; compressedDepth png"
    return {"format": described, "data": np.frombuffer(data, np.uint8)}


def _point_cloud(m: PointCloudMessage) -> Fields:
    names = ["x", "y", "z"] + (["rgb"] if m.colours is not None else [])
    cells = np.zeros((len(m.points), len(names)), np.float32)
    cells[:, :3] = m.points
    if m.colours is not None:
        red, green, blue = m.colours.astype(np.uint32).T
        cells[:, 3] = ((red << 16) | (green << 8) | blue).astype(np.uint32).view(np.float32)
    return {
        "height": 1,
        "width": len(cells),
        "fields": [
            {"name": name, "offset": 4 * i, "datatype": _FLOAT32, "count": 1}
            for i, name in enumerate(names)
        ],
        "point_step": 4 * len(names),
        "row_step": 4 * len(names) * len(cells),
        "data": cells.view(np.uint8).reshape(-1),
        "is_dense": True,
    }


_BUILDERS: dict[type, tuple[str, Callable[[Any], Fields]]] = {
    LaserScanMessage: ("sensor_msgs/msg/LaserScan", _laser_scan),
    OdometryMessage: ("nav_msgs/msg/Odometry", _odometry),
    ImuMessage: ("sensor_msgs/msg/Imu", _imu),
    TransformsMessage: ("tf2_msgs/msg/TFMessage", _transforms),
    PoseMessage: ("geometry_msgs/msg/PoseWithCovarianceStamped", _pose),
    GpsMessage: ("sensor_msgs/msg/NavSatFix", _gps),
    TextMessage: ("std_msgs/msg/String", _text),
    CameraInfoMessage: ("sensor_msgs/msg/CameraInfo", _camera_info),
    ImageMessage: ("sensor_msgs/msg/Image", _image),
    PointCloudMessage: ("sensor_msgs/msg/PointCloud2", _point_cloud),
}
TYPES: dict[MessageKind, str] = {made.kind: name for made, (name, _) in _BUILDERS.items()}  # type: ignore


_STEPS = np.arange(-4, 5)  # units in the last place around the first guess


def exact_quaternion(rotation: NDArray[np.float64]) -> tuple[float, float, float, float]:
    """X y z w of a rotation (3, 3); for one about z, exactly what a reader turns back into it.

    A log that is written and read again must give the same map byte for byte, so the last bit of
    a pose matters. Readers form `1 - 2 z z / (z z + w w)` and `2 z w / (z z + w w)`; the pair
    (z, w) that was read once lies within a few units in the last place of the half angle's.
    """
    if rotation[2, 2] != 1.0 or rotation[0, 0] != rotation[1, 1]:
        x, y, z, w = rotation_to_quaternion(rotation).tolist()
        return x, y, z, w
    half = 0.5 * np.arctan2(rotation[1, 0], rotation[0, 0])
    z, w = np.sin(half), np.cos(half)
    zs, ws = np.meshgrid(z + _STEPS * np.spacing(z), w + _STEPS * np.spacing(w), indexing="ij")
    scale = 2.0 / (zs * zs + ws * ws)
    cosines, sines = 1.0 - scale * zs * zs, scale * ws * zs
    wrong = (cosines != rotation[0, 0]) * 1.0 + (sines != rotation[1, 0]) * 1.0
    distance = np.abs(_STEPS)[:, None] + np.abs(_STEPS)[None, :]
    best = np.unravel_index(np.argmin(wrong * 100 + distance), wrong.shape)
    return 0.0, 0.0, float(zs[best]), float(ws[best])
