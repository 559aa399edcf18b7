"""Logs that we write: read back by us bit by bit, and by stock libraries value by value."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from mcap.reader import make_reader
from rosbags.highlevel import AnyReader
from rosbags.typesys import Stores, get_typestore

from formats.logs import open_log
from formats.logs.poses import pose_matrix
from formats.recording_files import LogWriter
from formats.ros_messages import exact_quaternion
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
    TransformStamped,
)

T0 = 1_600_000_000_000_000_001
POSE = pose_matrix((1.0, 2.0, 3.0, 0.0, 0.0, 0.6, 0.8))
SIX = np.arange(6.0)
COVARIANCE = np.arange(36.0).reshape(6, 6)
RGB = np.random.default_rng(3).integers(0, 256, (4, 6, 3), np.uint8)
DEPTH = np.array([[0.0, 0.5], [1.234, 65.535]], np.float32)
PNG = cv2.imencode(".png", RGB[..., ::-1])[1].tobytes()
DEPTH_PNG = cv2.imencode(".png", np.round(DEPTH * 1000).astype(np.uint16))[1].tobytes()
TYPE_STORE = get_typestore(Stores.ROS2_HUMBLE)


def messages() -> list[tuple[str, Message]]:
    scan = LaserScanMessage(
        T0, "laser", -1.5, 0.25, 0.0, 0.0, 0.0, 30.0,
        np.float32([1.07, np.nan, np.inf, 81.83]), np.zeros(0, np.float32),
    )  # fmt: skip
    transform = TransformStamped(T0, "base_link", "laser", POSE)
    return [
        ("/tf_static", TransformsMessage((transform,), static=True)),
        ("/tf", TransformsMessage((transform, transform), static=False)),
        ("/scan", scan),
        ("/odom", OdometryMessage(T0, "odom", "base", POSE, COVARIANCE, SIX, COVARIANCE)),
        ("/imu", ImuMessage(T0, "imu", None, np.arange(3.0), np.arange(3.0) + 3)),
        ("/imu2", ImuMessage(T0, "imu", np.array([0, 0, 0.6, 0.8]), np.ones(3), np.ones(3))),
        ("/pose", PoseMessage(T0, "map", POSE, COVARIANCE)),
        ("/text", TextMessage(T0, "hello")),
        ("/info", CameraInfoMessage(
            T0, "camera", 6, 4, "plumb_bob", np.arange(5.0), np.eye(3), np.eye(3), np.eye(3, 4)
        )),
        ("/rgb", ImageMessage(T0, "camera", "rgb8", 6, 4, lambda: RGB)),
        ("/grey", ImageMessage(T0, "camera", "mono8", 6, 4, lambda: RGB[..., 0])),
        ("/png", ImageMessage(T0, "camera", "rgb8", 6, 4, lambda: RGB, PNG)),
        ("/depth", ImageMessage(T0, "camera", "16UC1", 2, 2, lambda: DEPTH)),
        ("/float", ImageMessage(T0, "camera", "32FC1", 2, 2, lambda: DEPTH)),
        ("/packed", ImageMessage(T0, "camera", "16UC1", 2, 2, lambda: DEPTH, DEPTH_PNG)),
        ("/cloud", PointCloudMessage(T0, "c", np.float32([[1, 2, 3], [4, 5, 6]]), None)),
        ("/colours", PointCloudMessage(T0, "c", np.float32([[1, 2, 3]]), np.uint8([[7, 8, 9]]))),
    ]  # fmt: skip


OUTPUTS = ["a.mcap", "a.bag", "a.db3", "folder"]


@pytest.fixture(params=OUTPUTS, scope="module")
def written(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("out") / request.param
    with LogWriter(path) as writer:
        for number, (topic, message) in enumerate(messages()):
            writer.write(topic, message, T0 + number // 2)
    return path


def assert_same(a: Any, b: Any) -> None:
    assert type(a) is type(b)
    for name in a.__slots__:
        left, right = getattr(a, name), getattr(b, name)
        if name == "pixels":
            np.testing.assert_array_equal(left(), right())
        elif isinstance(left, np.ndarray):
            assert left.dtype == right.dtype
            np.testing.assert_array_equal(left, right)
        elif isinstance(left, tuple):
            for x, y in zip(left, right, strict=True):
                assert_same(x, y)
        else:
            assert left == right, name


def test_what_is_written_is_read_back_bit_by_bit(written: Path) -> None:
    found = list(open_log([written]).messages())
    assert [m.log_time_ns for m in found] == [T0 + n // 2 for n in range(len(found))]
    for raw, (topic, message) in zip(found, messages(), strict=True):
        assert raw.topic == topic
        if topic == "/text":  # which has no stamp of its own
            assert raw.decode().text == "hello"  # type: ignore[union-attr]
        else:
            assert_same(raw.decode(), message)


@pytest.mark.parametrize("written", ["a.mcap", "a.bag", "folder"], indirect=True)
def test_stock_readers_take_it(written: Path) -> None:
    """Rosbags checks structure and types; a lone .db3 lacks the folder it insists on."""
    with AnyReader([written], default_typestore=TYPE_STORE) as reader:
        found = {c.topic: reader.deserialize(data, c.msgtype) for c, _, data in reader.messages()}
    assert found["/scan"].ranges[0] == np.float32(1.07)
    assert found["/scan"].angle_max == -0.75
    assert found["/odom"].pose.pose.position.y == 2.0
    assert found["/odom"].header.stamp.nanosec == 1
    assert found["/depth"].encoding == "16UC1"
    assert found["/packed"].format == "16UC1; compressedDepth png"
    assert found["/imu"].orientation_covariance[0] == -1
    assert found["/colours"].fields[3].name == "rgb"


def test_mcap_has_summary_definitions_and_latched_statics(tmp_path: Path) -> None:
    path = tmp_path / "a.mcap"
    with LogWriter(path, compression="lz4") as writer:
        for topic, message in messages():
            writer.write(topic, message, T0)
    with path.open("rb") as stream:
        summary = make_reader(stream, validate_crcs=True).get_summary()
    assert summary is not None
    assert summary.statistics is not None
    assert summary.statistics.message_count == len(messages())
    schemas = {s.name: s for s in summary.schemas.values()}
    assert schemas["sensor_msgs/msg/LaserScan"].encoding == "ros2msg"
    assert b"float32[] ranges" in schemas["sensor_msgs/msg/LaserScan"].data
    qos = {c.topic: c.metadata.get("offered_qos_profiles", "") for c in summary.channels.values()}
    assert "durability: 1" in qos["/tf_static"]
    assert qos["/tf"] == ""


def test_ros1_definitions_have_the_known_hashes(tmp_path: Path) -> None:
    """MD5 sums as every ROS 1 installation has them."""
    path = tmp_path / "a.bag"
    with LogWriter(path) as writer:
        for topic, message in messages():
            writer.write(topic, message, T0)
    with AnyReader([path]) as reader:
        digests = {c.msgtype: c.digest for c in reader.connections}
    assert digests["sensor_msgs/msg/LaserScan"] == "90c7ef2dc6895d81024acba2ac42f369"
    assert digests["nav_msgs/msg/Odometry"] == "cd5e73d190d741a2f92e81eda573aca7"
    assert digests["tf2_msgs/msg/TFMessage"] == "94810edda583a504dfda3829e70d7eec"
    assert digests["sensor_msgs/msg/PointCloud2"] == "1158d486dd51d683ce2f1be655c3c181"


@settings(max_examples=300)
@given(st.floats(-np.pi, np.pi))
def test_planar_rotations_survive_to_the_last_bit(yaw: float) -> None:
    matrix = pose_matrix((0, 0, 0, 0, 0, np.sin(yaw / 2), np.cos(yaw / 2)))
    again = pose_matrix((0, 0, 0, *exact_quaternion(matrix[:3, :3])))
    np.testing.assert_array_equal(again, matrix)


def test_rotations_in_space_survive_to_rounding() -> None:
    quaternion = np.array([0.1, -0.2, 0.3, 0.9])
    matrix = pose_matrix((0, 0, 0, *quaternion))
    again = pose_matrix((0, 0, 0, *exact_quaternion(matrix[:3, :3])))
    np.testing.assert_allclose(again, matrix, atol=1e-15)


def test_an_existing_file_is_not_touched_unless_asked(tmp_path: Path) -> None:
    path = tmp_path / "a.mcap"
    path.write_text("precious")
    with pytest.raises(LogError, match="exists already"):
        LogWriter(path)
    assert path.read_text() == "precious"
    with LogWriter(path, overwrite=True) as writer:
        writer.write("/text", TextMessage(0, "new"), 1)
    assert open_log([path]).info().message_count == 1
    folder = tmp_path / "folder"
    folder.mkdir()
    (folder / "thesis.tex").write_text("precious")
    with pytest.raises(LogError, match="no recording"):
        LogWriter(folder, overwrite=True)


@pytest.mark.parametrize("name", ["a.mcap", "a.bag", "a.db3", "folder"])
def test_until_a_log_is_whole_the_one_before_stays(tmp_path: Path, name: str) -> None:
    path = tmp_path / name
    for count in (1, 2):
        with LogWriter(path, overwrite=count == 2) as writer:
            for time in range(count):
                writer.write("/text", TextMessage(time, "x"), time)
            found = sum(1 for _ in open_log([path]).messages()) if path.exists() else 0
            assert found == count - 1  # a writer that is killed here has changed nothing
    assert sum(1 for _ in open_log([path]).messages()) == 2
    assert list(tmp_path.iterdir()) == [path]


def test_bad_outputs_are_refused(tmp_path: Path) -> None:
    with pytest.raises(LogError, match="folder does not exist"):
        LogWriter(tmp_path / "none" / "a.mcap")
    with pytest.raises(LogError, match="cannot be compressed by bz2"):
        LogWriter(tmp_path / "a.mcap", compression="bz2")


@pytest.mark.parametrize("name", OUTPUTS)
def test_nothing_is_left_of_a_writing_that_failed(tmp_path: Path, name: str) -> None:
    def write_and_fail() -> None:
        with LogWriter(tmp_path / name) as writer:
            writer.write("/text", TextMessage(0, "x"), 1)
            raise RuntimeError

    with pytest.raises(RuntimeError):
        write_and_fail()
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize(
    ("name", "compression"),
    [("a.bag", "bz2"), ("a.bag", "lz4"), ("a.db3", "zstd"), ("f", "zstd"), ("a.mcap", "none")],
)
def test_compressed_outputs_are_smaller_and_the_same(
    tmp_path: Path, name: str, compression: str
) -> None:
    scan = dict(messages())["/scan"]
    path = tmp_path / name
    with LogWriter(path, compression=compression) as writer:
        for i in range(200):
            writer.write("/scan", scan, T0 + i)
    found = [m.decode() for m in open_log([path]).messages()]
    assert len(found) == 200
    assert_same(found[7], scan)
