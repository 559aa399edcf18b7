"""Foxglove's types in protobuf, JSON and ROS 2 clothes: the same message each time."""

from __future__ import annotations

import base64
import json
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from google.protobuf import descriptor_pb2, descriptor_pool, message_factory, timestamp_pb2
from mcap.writer import Writer
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from formats.logs import open_log
from mapmyworld.errors import LogError
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
)

STAMP = 1_700_000_000_000_000_007
RGB = np.random.default_rng(2).integers(0, 256, (4, 5, 3), np.uint8)
PNG = cv2.imencode(".png", RGB[..., ::-1])[1].tobytes()
POINTS = np.array([[1, 2, 3], [4, 5, np.nan], [7, 8, 9]], np.float32)
POSITION, TURN = {"x": 1.0, "y": 2.0, "z": 3.0}, {"x": 0.0, "y": 0.0, "z": 0.6, "w": 0.8}
POSE = {"position": POSITION, "orientation": TURN}
STILL = {"position": dict.fromkeys("xyz", 0.0), "orientation": {**TURN, "z": 0.0, "w": 1.0}}

# Type -> fields as (name, protobuf type, number), in the order of Foxglove's schemas.
D, S, U, B = "double", "string", "fixed32", "bytes"
SCHEMAS: dict[str, list[tuple[str, str, int]]] = {
    "Vector3": [("x", D, 1), ("y", D, 2), ("z", D, 3)],
    "Quaternion": [("x", D, 1), ("y", D, 2), ("z", D, 3), ("w", D, 4)],
    "Pose": [("position", "Vector3", 1), ("orientation", "Quaternion", 2)],
    "PackedElementField": [("name", S, 1), ("offset", U, 2), ("type", "int32", 3)],
    "LaserScan": [
        ("timestamp", "Timestamp", 1), ("frame_id", S, 2), ("pose", "Pose", 3),
        ("start_angle", D, 4), ("end_angle", D, 5), ("ranges", D + "[]", 6),
        ("intensities", D + "[]", 7),
    ],
    "CompressedImage": [
        ("timestamp", "Timestamp", 1), ("frame_id", S, 4), ("data", B, 2), ("format", S, 3),
    ],
    "RawImage": [
        ("timestamp", "Timestamp", 1), ("frame_id", S, 7), ("width", U, 2), ("height", U, 3),
        ("encoding", S, 4), ("step", U, 5), ("data", B, 6),
    ],
    "CameraCalibration": [
        ("timestamp", "Timestamp", 1), ("frame_id", S, 9), ("width", U, 2), ("height", U, 3),
        ("distortion_model", S, 4), ("D", D + "[]", 5), ("K", D + "[]", 6), ("R", D + "[]", 7),
        ("P", D + "[]", 8),
    ],
    "FrameTransform": [
        ("timestamp", "Timestamp", 1), ("parent_frame_id", S, 2), ("child_frame_id", S, 3),
        ("translation", "Vector3", 4), ("rotation", "Quaternion", 5),
    ],
    "FrameTransforms": [("transforms", "FrameTransform[]", 1)],
    "PoseInFrame": [("timestamp", "Timestamp", 1), ("frame_id", S, 2), ("pose", "Pose", 3)],
    "Odometry": [
        ("timestamp", "Timestamp", 1), ("frame_id", S, 2), ("body_frame_id", S, 3),
        ("pose", "Pose", 4), ("linear_velocity", "Vector3", 5), ("angular_velocity", "Vector3", 6),
        ("pose_covariance", D + "[]", 7),
    ],
    "PointCloud": [
        ("timestamp", "Timestamp", 1), ("frame_id", S, 2), ("pose", "Pose", 3),
        ("point_stride", U, 4), ("fields", "PackedElementField[]", 5), ("data", B, 6),
    ],
}  # fmt: skip
FRAME_TRANSFORM = {
    "timestamp": STAMP, "parent_frame_id": "odom", "child_frame_id": "base",
    "translation": POSITION, "rotation": TURN,
}  # fmt: skip
VALUES: dict[str, dict[str, Any]] = {
    "LaserScan": {
        "timestamp": STAMP, "frame_id": "laser", "pose": STILL, "start_angle": -1.0,
        "end_angle": 1.0, "ranges": [1.0, 2.5, 4.0], "intensities": [],
    },
    "CompressedImage": {"timestamp": STAMP, "frame_id": "camera", "data": PNG, "format": "png"},
    "RawImage": {
        "timestamp": STAMP, "frame_id": "camera", "width": 5, "height": 4, "encoding": "rgb8",
        "step": 15, "data": RGB.tobytes(),
    },
    "CameraCalibration": {
        "timestamp": STAMP, "frame_id": "camera", "width": 640, "height": 480,
        "distortion_model": "plumb_bob", "D": [0.1, 0.2, 0.0, 0.0, 0.3],
        "K": list(np.arange(9.0)), "R": list(np.eye(3).ravel()), "P": list(np.arange(12.0)),
    },
    "FrameTransform": FRAME_TRANSFORM,
    "FrameTransforms": {"transforms": [FRAME_TRANSFORM, FRAME_TRANSFORM]},
    "PoseInFrame": {"timestamp": STAMP, "frame_id": "map", "pose": POSE},
    "Odometry": {
        "timestamp": STAMP, "frame_id": "odom", "body_frame_id": "base", "pose": POSE,
        "linear_velocity": POSITION, "angular_velocity": {"x": 4.0, "y": 5.0, "z": 6.0},
        "pose_covariance": list(np.arange(36.0)),
    },
    "PointCloud": {
        "timestamp": STAMP, "frame_id": "lidar", "pose": STILL, "point_stride": 12,
        "fields": [{"name": n, "offset": 4 * i, "type": 7} for i, n in enumerate("xyz")],
        "data": POINTS.tobytes(),
    },
}  # fmt: skip


def protobuf_files() -> descriptor_pb2.FileDescriptorSet:
    kinds = descriptor_pb2.FieldDescriptorProto
    file = descriptor_pb2.FileDescriptorProto(name="foxglove/all.proto", package="foxglove")
    file.syntax = "proto3"
    file.dependency.append("google/protobuf/timestamp.proto")
    for name, fields in SCHEMAS.items():
        message = file.message_type.add(name=name)
        for field_name, kind, number in fields:
            field = message.field.add(name=field_name, number=number)
            field.label = kinds.LABEL_REPEATED if kind.endswith("[]") else kinds.LABEL_OPTIONAL
            bare = kind.removesuffix("[]")
            if bare[0].isupper():
                field.type = kinds.TYPE_MESSAGE
                package = ".google.protobuf." if bare == "Timestamp" else ".foxglove."
                field.type_name = package + bare
            else:
                field.type = getattr(kinds, f"TYPE_{bare.upper()}")
    files = descriptor_pb2.FileDescriptorSet()
    files.file.append(file)  # dependency last: readers must not rely on the order
    timestamp_pb2.DESCRIPTOR.CopyToProto(files.file.add())
    return files


FILES = protobuf_files()
_POOL = descriptor_pool.DescriptorPool()
for _file in reversed(FILES.file):
    _POOL.Add(_file)


def as_protobuf(name: str, value: dict[str, Any]) -> bytes:
    message = message_factory.GetMessageClass(_POOL.FindMessageTypeByName(f"foxglove.{name}"))()

    def fill(target: Any, fields: dict[str, Any]) -> None:
        for key, item in fields.items():
            if key == "timestamp":
                target.timestamp.FromNanoseconds(item)
            elif isinstance(item, dict):
                fill(getattr(target, key), item)
            elif isinstance(item, list) and item and isinstance(item[0], dict):
                for one in item:
                    fill(getattr(target, key).add(), one)
            elif isinstance(item, list):
                getattr(target, key).extend(item)
            else:
                setattr(target, key, item)

    fill(message, value)
    return message.SerializeToString()


def as_json(value: Any) -> Any:
    if isinstance(value, dict):
        return {
            key: {"sec": item // 10**9, "nsec": item % 10**9}
            if key == "timestamp"
            else as_json(item)
            for key, item in value.items()
        }
    if isinstance(value, list):
        return [as_json(item) for item in value]
    return base64.b64encode(value).decode() if isinstance(value, bytes) else value


_ROS = {D: "float64", S: "string", U: "uint32", B: "uint8[]", "int32": "uint8"}
_ROS |= {"Timestamp": "builtin_interfaces/Time"}


def ros_definition(name: str) -> str:
    def lines(of: str) -> str:
        return "".join(f"{ros_type(kind)} {field.lower()}\n" for field, kind, _ in SCHEMAS[of])

    def ros_type(kind: str) -> str:
        bare = kind.removesuffix("[]")
        found = _ROS.get(bare, f"foxglove_msgs/{bare}")
        return found + kind[len(bare) :]

    used = [n for n in SCHEMAS if n != name]
    parts = [lines(name)] + [f"MSG: foxglove_msgs/{n}\n{lines(n)}" for n in used]
    return ("=" * 80 + "\n").join(parts)


def as_ros2(name: str, value: dict[str, Any]) -> bytes:
    store = get_typestore(Stores.EMPTY)
    store.register(get_types_from_msg(ros_definition(name), f"foxglove_msgs/msg/{name}"))

    def build(of: str, fields: dict[str, Any]) -> Any:
        made = []
        for key, kind, _ in SCHEMAS[of]:
            item, bare = fields[key], kind.removesuffix("[]")
            if bare == "Timestamp":
                made.append(store.types["builtin_interfaces/msg/Time"](*divmod(item, 10**9)))
            elif bare in SCHEMAS and kind != bare:
                made.append([build(bare, one) for one in item])
            elif bare in SCHEMAS:
                made.append(build(bare, item))
            elif kind == D + "[]":
                made.append(np.array(item, np.float64))
            else:
                made.append(np.frombuffer(item, np.uint8) if bare == B else item)
        return store.types[f"foxglove_msgs/msg/{of}"](*made)

    return bytes(store.serialize_cdr(build(name, value), f"foxglove_msgs/msg/{name}"))


def write(
    path: Path, encoding: str, topic: str = "/t", value: dict[str, Any] | None = None
) -> Path:
    with path.open("wb") as stream:
        writer = Writer(stream)
        writer.start()
        for name in VALUES if value is None else ["LaserScan"]:
            fields = VALUES[name] if value is None else value
            if encoding == "protobuf":
                schema = writer.register_schema(
                    f"foxglove.{name}", "protobuf", FILES.SerializeToString()
                )
                data = as_protobuf(name, fields)
            elif encoding == "json":
                schema = writer.register_schema(f"foxglove.{name}", "jsonschema", b"{}")
                data = json.dumps(as_json(fields)).encode()
            else:
                text = ros_definition(name).encode()
                schema = writer.register_schema(f"foxglove_msgs/msg/{name}", "ros2msg", text)
                data = as_ros2(name, fields)
            channel = writer.register_channel(f"{topic}/{name}", encoding, schema)
            writer.add_message(channel, 5, data, 5)
        writer.finish()
    return path


@pytest.fixture(params=["protobuf", "json", "cdr"], scope="module")
def messages(
    request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory
) -> dict[str, Message]:
    found = {}
    path = tmp_path_factory.mktemp("foxglove") / "a.mcap"
    for raw in open_log([write(path, request.param)]).messages():
        assert raw.kind is not MessageKind.OTHER
        assert raw.stamp_ns == STAMP
        found[raw.topic.rsplit("/", 1)[1]] = raw.decode()
    assert all(message.stamp_ns == STAMP for message in found.values())
    return found


def test_every_type_in_every_encoding(messages: dict[str, Message]) -> None:
    assert set(messages) == set(VALUES)


def test_a_scan_keeps_ranges_angles_and_frame(messages: dict[str, Message]) -> None:
    scan = messages["LaserScan"]
    assert isinstance(scan, LaserScanMessage)
    assert scan.ranges.tolist() == [1.0, 2.5, 4.0]
    assert (scan.angle_min, scan.angle_increment, scan.frame_id) == (-1.0, 1.0, "laser")


def test_images_raw_and_compressed_show_the_same(messages: dict[str, Message]) -> None:
    for name in ("RawImage", "CompressedImage"):
        image = messages[name]
        assert isinstance(image, ImageMessage)
        assert (image.frame_id, image.width, image.height) == ("camera", 5, 4)
        np.testing.assert_array_equal(image.pixels(), RGB)
    assert messages["CompressedImage"].encoded == PNG  # type: ignore[union-attr]


def test_a_calibration_keeps_lens_and_size(messages: dict[str, Message]) -> None:
    info = messages["CameraCalibration"]
    assert isinstance(info, CameraInfoMessage)
    assert (info.width, info.height, info.distortion_model) == (640, 480, "plumb_bob")
    assert info.distortion.tolist() == [0.1, 0.2, 0.0, 0.0, 0.3]
    assert info.intrinsics.ravel().tolist() == list(range(9))
    assert info.projection.shape == (3, 4)


def test_poses_and_transforms(messages: dict[str, Message]) -> None:
    single, several = messages["FrameTransform"], messages["FrameTransforms"]
    pose, odometry = messages["PoseInFrame"], messages["Odometry"]
    assert isinstance(single, TransformsMessage)
    assert isinstance(several, TransformsMessage)
    assert isinstance(pose, PoseMessage)
    assert isinstance(odometry, OdometryMessage)
    assert len(several.transforms) == 2
    matrices = [single.transforms[0].parent_from_child, several.transforms[1].parent_from_child]
    for matrix in [*matrices, pose.pose, odometry.pose]:
        np.testing.assert_allclose(matrix[:3, 3], [1, 2, 3])
        np.testing.assert_allclose(matrix[:2, 0], [0.28, 0.96])  # cos and sin of 2 atan(0.6 / 0.8)
    assert (single.transforms[0].parent, single.transforms[0].child) == ("odom", "base")
    assert (odometry.child_frame_id, odometry.twist.tolist()) == ("base", [1, 2, 3, 4, 5, 6])
    assert odometry.pose_covariance.ravel().tolist() == list(range(36))


def test_a_cloud_loses_points_that_are_not_finite(messages: dict[str, Message]) -> None:
    cloud = messages["PointCloud"]
    assert isinstance(cloud, PointCloudMessage)
    np.testing.assert_array_equal(cloud.points, POINTS[[0, 2]])


def test_a_turned_lidar_turns_its_beams(tmp_path: Path) -> None:
    value = {**VALUES["LaserScan"], "pose": {"position": POSITION, "orientation": TURN}}
    (raw,) = open_log([write(tmp_path / "a.mcap", "json", value=value)]).messages()
    scan = raw.decode()
    assert isinstance(scan, LaserScanMessage)
    assert scan.angle_min == pytest.approx(-1.0 + 2 * np.arctan2(0.6, 0.8))


@pytest.mark.parametrize("encoding", ["protobuf", "json"])
def test_damaged_messages_and_schemas(tmp_path: Path, encoding: str) -> None:
    path = tmp_path / "a.mcap"
    with path.open("wb") as stream:
        writer = Writer(stream)
        writer.start()
        good = FILES.SerializeToString() if encoding == "protobuf" else b"{}"
        for number, schema_data in enumerate((good, b"\x0a\xff\xff")):
            schema = writer.register_schema("foxglove.LaserScan", encoding, schema_data)
            channel = writer.register_channel(f"/{number}", encoding, schema)
            writer.add_message(channel, 1, b'\x0a\x03{"ranges": "no"}\xff', 1)
            if encoding == "json":
                writer.add_message(channel, 2, b'{"ranges": ' + b"[" * 100_000, 2)
        writer.finish()
    for raw in open_log([path]).messages():
        with pytest.raises(LogError, match=raw.topic):
            raw.decode()
