"""Every message type, serialised by rosbags in both wire formats, decodes to what was put in."""

from __future__ import annotations

import struct
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from log_builders import STORES, Make, allowed, changes, damaged, serialised
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from formats.logs.channels import Channel
from formats.logs.decoding import decoder_for
from mapmyworld.errors import LogError
from mapmyworld.geometry.rigid import make_transform
from mapmyworld.geometry.rotations import quaternion_to_rotation
from mapmyworld.types import (
    CameraInfoMessage,
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

STAMP = 1_600_000_000_123_456_789
POSE = make_transform(quaternion_to_rotation([0, 0, 0.6, 0.8]), [1.0, 2.0, 3.0])


def channel(ros: int, name: str, topic: str = "/t") -> Channel:
    text, digest = STORES[ros].generate_msgdef(name, ros_version=ros)
    if ros == 1:
        return Channel(topic, name, "ros1", "ros1msg", text.encode(), digest)
    return Channel(topic, name, "cdr", "ros2msg", text.encode())


def decode(ros: int, name: str, message: Any, topic: str = "/t") -> Message:
    """By way of the bytes, in little and (for CDR) big endian, which must agree."""
    decoder = decoder_for(channel(ros, name, topic))
    data = serialised(ros, ("", name, 0, message))
    decoded = decoder.message(data, 5).decode()
    if decoder.kind is not MessageKind.TEXT:
        assert decoder.message(data, 0).stamp_ns == decoded.stamp_ns == STAMP
    if ros == 2:
        big = bytes(STORES[2].serialize_cdr(message, name, little_endian=False))
        other = decoder.message(big, 5).decode()
        assert_same(other, decoded)
        if decoder.kind is not MessageKind.TEXT:
            assert decoder.message(big, 0).stamp_ns == STAMP
    return decoded


def assert_same(a: Any, b: Any) -> None:
    """Equal in every field, arrays bit by bit."""
    assert type(a) is type(b)
    for name in a.__slots__:
        left, right = getattr(a, name), getattr(b, name)
        if isinstance(left, np.ndarray):
            assert left.dtype == right.dtype
            np.testing.assert_array_equal(left, right)
        elif isinstance(left, tuple):
            for x, y in zip(left, right, strict=True):
                assert_same(x, y)
        elif not callable(left):
            assert left == right


@pytest.mark.parametrize("ros", [1, 2])
def test_a_scan_keeps_every_reading_as_recorded(ros: int) -> None:
    message = Make(ros).scan(STAMP, [1.0, np.nan, np.inf, 0.0, 81.83])
    scan = decode(ros, "sensor_msgs/msg/LaserScan", message)
    assert isinstance(scan, LaserScanMessage)
    np.testing.assert_array_equal(scan.ranges, np.float32([1.0, np.nan, np.inf, 0.0, 81.83]))
    np.testing.assert_array_equal(scan.intensities, scan.ranges * 10)
    assert scan.frame_id == "laser"
    assert (scan.angle_min, scan.angle_increment) == (-1.5, 0.25)
    assert scan.time_increment == np.float32(0.001)
    assert (scan.scan_time, scan.range_min) == (np.float32(0.1), np.float32(0.05))
    assert scan.range_max == 30.0
    assert not scan.ranges.flags.writeable or ros == 2


@pytest.mark.parametrize("ros", [1, 2])
def test_multi_echo_scan_gives_first_echoes(ros: int) -> None:
    make = Make(ros)
    echoes = [
        make("sensor_msgs/msg/LaserEcho", np.array(values, np.float32))
        for values in ([1.0, 2.0], [], [3.0])
    ]
    name = "sensor_msgs/msg/MultiEchoLaserScan"
    message = make(
        name, make.header(STAMP, "l"), -1.0, 1.0, 1.0, 0.0, 0.0, 0.1, 9.0, echoes, echoes
    )
    scan = decode(ros, name, message)
    assert isinstance(scan, LaserScanMessage)
    assert scan.ranges.tolist() == [1.0, np.inf, 3.0]
    assert scan.intensities.tolist() == [1.0, 0.0, 3.0]


@pytest.mark.parametrize("ros", [1, 2])
@pytest.mark.parametrize("child", ["", "b", "base_link", "/base_footprint"])
def test_odometry_is_read_behind_child_names_of_any_length(ros: int, child: str) -> None:
    """Child names of all lengths move what follows them, and its alignment."""
    odometry = decode(ros, "nav_msgs/msg/Odometry", Make(ros).odometry(STAMP, child))
    assert isinstance(odometry, OdometryMessage)
    assert (odometry.frame_id, odometry.child_frame_id) == ("odom", child)
    np.testing.assert_allclose(odometry.pose, POSE, atol=1e-15)
    np.testing.assert_array_equal(odometry.pose_covariance, np.arange(36.0).reshape(6, 6))
    np.testing.assert_array_equal(odometry.twist, [1, 2, 3, 4, 5, 6])
    np.testing.assert_array_equal(odometry.twist_covariance.ravel(), np.arange(36.0) + 0.5)


@pytest.mark.parametrize("ros", [1, 2])
@pytest.mark.parametrize(("topic", "static"), [("/tf", False), ("/tf_static", True)])
def test_transforms_are_static_by_their_topic(ros: int, topic: str, static: bool) -> None:
    names = [("/odom", "/base"), ("a", "bcd"), ("", "x")]
    message = Make(ros).transforms(STAMP, names)
    found = decode(ros, "tf2_msgs/msg/TFMessage", message, topic)
    assert isinstance(found, TransformsMessage)
    assert found.static is static
    assert [(t.parent, t.child) for t in found.transforms] == names
    for transform in found.transforms:
        np.testing.assert_allclose(transform.parent_from_child, POSE, atol=1e-15)
        assert transform.stamp_ns == STAMP


def test_the_first_tf_type_of_ros1_is_read() -> None:
    data = serialised(1, ("", "tf2_msgs/msg/TFMessage", 0, Make(1).transforms(STAMP, [("a", "b")])))
    text = b"geometry_msgs/TransformStamped[] transforms\n"
    decoder = decoder_for(Channel("/tf", "tf/msg/tfMessage", "ros1", "ros1msg", text))
    assert decoder.message(data, 0).stamp_ns == STAMP
    found = decoder.message(data, 0).decode()
    assert isinstance(found, TransformsMessage)
    assert found.transforms[0].child == "b"


@pytest.mark.parametrize("ros", [1, 2])
@pytest.mark.parametrize(
    ("first", "quaternion", "known"),
    [(0.1, (0, 0, 0, 1), True), (-1.0, (0, 0, 0, 1), False), (0.0, (0, 0, 0, 0), False)],
)
def test_an_orientation_that_a_device_denies_is_none(
    ros: int, first: float, quaternion: tuple[float, ...], known: bool
) -> None:
    make, covariance = Make(ros), np.full(9, first)
    orientation = make("geometry_msgs/msg/Quaternion", *map(float, quaternion))
    message = make(
        "sensor_msgs/msg/Imu", make.header(STAMP, "imu"), orientation, covariance,
        make.vector(1, 2, 3), np.zeros(9), make.vector(4, 5, 6), np.zeros(9),
    )  # fmt: skip
    imu = decode(ros, "sensor_msgs/msg/Imu", message)
    assert isinstance(imu, ImuMessage)
    assert (imu.orientation is not None) is known
    assert imu.angular_velocity.tolist() == [1, 2, 3]
    assert imu.linear_acceleration.tolist() == [4, 5, 6]


@pytest.mark.parametrize("ros", [1, 2])
@pytest.mark.parametrize(
    ("model", "count"), [("plumb_bob", 5), ("rational_polynomial", 8), ("equidistant", 4), ("", 0)]
)
def test_camera_info_keeps_all_matrices(ros: int, model: str, count: int) -> None:
    make = Make(ros)
    roi = make("sensor_msgs/msg/RegionOfInterest", 0, 0, 0, 0, False)
    k, r, p = np.arange(9.0), np.arange(9.0) + 20, np.arange(12.0) + 40
    message = make(
        "sensor_msgs/msg/CameraInfo", make.header(STAMP, "camera"), 480, 640, model,
        np.arange(count, dtype=np.float64), k, r, p, 0, 0, roi,
    )  # fmt: skip
    info = decode(ros, "sensor_msgs/msg/CameraInfo", message)
    assert isinstance(info, CameraInfoMessage)
    assert (info.width, info.height, info.distortion_model) == (640, 480, model)
    np.testing.assert_array_equal(info.distortion, np.arange(count))
    np.testing.assert_array_equal(info.intrinsics.ravel(), k)
    np.testing.assert_array_equal(info.rectification.ravel(), r)
    np.testing.assert_array_equal(info.projection.ravel(), p)


@pytest.mark.parametrize("ros", [1, 2])
def test_poses_with_and_without_covariance(ros: int) -> None:
    make = Make(ros)
    plain = make("geometry_msgs/msg/PoseStamped", make.header(STAMP, "map"), make.pose())
    with_covariance = make(
        "geometry_msgs/msg/PoseWithCovarianceStamped",
        make.header(STAMP, "map"),
        make("geometry_msgs/msg/PoseWithCovariance", make.pose(), np.arange(36.0)),
    )
    for name, message, first in (
        ("geometry_msgs/msg/PoseStamped", plain, 0.0),
        ("geometry_msgs/msg/PoseWithCovarianceStamped", with_covariance, 1.0),
    ):
        pose = decode(ros, name, message)
        assert isinstance(pose, PoseMessage)
        assert pose.frame_id == "map"
        assert pose.covariance[0, 1] == first
        np.testing.assert_allclose(pose.pose, POSE, atol=1e-15)


@pytest.mark.parametrize("ros", [1, 2])
def test_text_has_the_log_time(ros: int) -> None:
    text = decode(ros, "std_msgs/msg/String", Make(ros).text("Grüße"))
    assert isinstance(text, TextMessage)
    assert (text.text, text.stamp_ns) == ("Grüße", 5)


def cloud(
    ros: int, cells: np.ndarray, *, height: int = 1, pad: int = 0, colour: str = "rgb"
) -> Any:
    """A PointCloud2 of x y z and a colour, rows padded by `pad` bytes."""
    make = Make(ros)
    width = len(cells) // height
    rows = cells.view(np.uint8).reshape(height, -1)
    data = np.hstack([rows, np.full((height, pad), 255, np.uint8)]).reshape(-1)
    fields = [
        make("sensor_msgs/msg/PointField", name, 4 * i, 7, 1)
        for i, name in enumerate(("x", "y", "z", colour))
    ]
    return make(
        "sensor_msgs/msg/PointCloud2", make.header(STAMP, "c"), height, width, fields, False,
        16, 16 * width + pad, data, False,
    )  # fmt: skip


@pytest.mark.parametrize("ros", [1, 2])
@pytest.mark.parametrize(("height", "pad"), [(1, 0), (2, 0), (2, 8)])
def test_point_cloud_drops_points_that_are_not_finite(ros: int, height: int, pad: int) -> None:
    cells = np.arange(16, dtype=np.float32).reshape(4, 4)
    cells[:, 3] = np.uint32([0x010203, 0x040506, 0x070809, 0x0A0B0C]).view(np.float32)
    cells[1, 2] = np.nan
    found = decode(ros, "sensor_msgs/msg/PointCloud2", cloud(ros, cells, height=height, pad=pad))
    assert isinstance(found, PointCloudMessage)
    np.testing.assert_array_equal(found.points, cells[[0, 2, 3], :3])
    assert found.colours is not None
    np.testing.assert_array_equal(found.colours, [[1, 2, 3], [7, 8, 9], [10, 11, 12]])


def test_point_cloud_without_colour_or_coordinates() -> None:
    cells = np.arange(8, dtype=np.float32).reshape(2, 4)
    found = decode(2, "sensor_msgs/msg/PointCloud2", cloud(2, cells, colour="intensity"))
    assert isinstance(found, PointCloudMessage)
    assert found.colours is None
    message = cloud(2, cells)
    message.fields[0].name = "range"
    with pytest.raises(LogError, match="without x, y and z"):
        decode(2, "sensor_msgs/msg/PointCloud2", message)


def test_unknown_types_are_other_and_never_decoded() -> None:
    for found in (Channel("/a", "my_msgs/msg/Thing", "cdr"), Channel("/b", "", "", "", b"")):
        decoder = decoder_for(found)
        assert decoder.kind is MessageKind.OTHER
        assert decoder.message(b"anything", 0).stamp_ns is None
        with pytest.raises(LogError, match="not decoded"):
            decoder.message(b"anything", 0).decode()


def test_a_type_laid_out_otherwise_is_read_by_its_own_definition() -> None:
    """A LaserScan of one's own, with a field more in front, keeps the fields that have names."""
    text = (
        "uint8 quality\nstd_msgs/Header header\nfloat32 angle_min\nfloat32 angle_max\n"
        "float32 angle_increment\nfloat32 range_max\nfloat32[] ranges\n"
        + "=" * 80
        + "\nMSG: std_msgs/Header\nbuiltin_interfaces/Time stamp\nstring frame_id\n"
    )
    name = "sensor_msgs/msg/LaserScan"
    own = get_typestore(Stores.EMPTY)
    own.register(get_types_from_msg(text, name))
    header = own.types["std_msgs/msg/Header"](
        own.types["builtin_interfaces/msg/Time"](*divmod(STAMP, 10**9)), "mine"
    )
    message = own.types[name](3, header, -1.0, 1.0, 0.5, 20.0, np.float32([1, 2, 3]))
    decoder = decoder_for(Channel("/scan", name, "cdr", "ros2msg", text.encode()))
    data = bytes(own.serialize_cdr(message, name))
    scan = decoder.message(data, 0).decode()
    assert isinstance(scan, LaserScanMessage)
    assert decoder.message(data, 0).stamp_ns == STAMP
    assert (scan.frame_id, scan.range_max, scan.range_min) == ("mine", 20.0, 0.0)
    assert scan.ranges.tolist() == [1, 2, 3]


def test_definitions_in_idl_are_understood() -> None:
    text = "=" * 80 + "\nIDL: std_msgs/msg/String\nmodule std_msgs {\n  module msg {\n"
    text += "    struct String {\n      string data;\n    };\n  };\n};\n"
    decoder = decoder_for(Channel("/t", "std_msgs/msg/String", "cdr", "ros2idl", text.encode()))
    data = serialised(2, ("", "std_msgs/msg/String", 0, Make(2).text("by IDL")))
    assert decoder.message(data, 0).decode().text == "by IDL"  # type: ignore[union-attr]


def test_a_definition_that_is_none_leaves_the_standard_one() -> None:
    decoder = decoder_for(Channel("/t", "std_msgs/msg/String", "cdr", "ros2msg", b"\xff not msg"))
    data = serialised(2, ("", "std_msgs/msg/String", 0, Make(2).text("all the same")))
    assert decoder.message(data, 0).decode().text == "all the same"  # type: ignore[union-attr]


SAMPLES = [
    ("sensor_msgs/msg/LaserScan", lambda make: make.scan(STAMP)),
    ("nav_msgs/msg/Odometry", lambda make: make.odometry(STAMP)),
    ("tf2_msgs/msg/TFMessage", lambda make: make.transforms(STAMP, [("a", "b")])),
    ("sensor_msgs/msg/PointCloud2", lambda make: cloud(make.ros, np.zeros((3, 4), np.float32))),
]


@pytest.mark.parametrize("ros", [1, 2])
@pytest.mark.parametrize(("name", "build"), SAMPLES)
@settings(max_examples=80)
@given(wrong=changes(), kept=st.floats(0.0, 1.0))
def test_damaged_messages_raise_log_errors_only(
    ros: int, name: str, build: Any, wrong: list[tuple[float, int]], kept: float
) -> None:
    decoder = decoder_for(channel(ros, name, "/topic"))
    data = damaged(serialised(ros, ("", name, 0, build(Make(ros)))), wrong, kept)
    message = allowed(lambda: decoder.message(data, 7).decode(), "/topic")
    assert message is None or isinstance(message.stamp_ns, int)


def test_a_count_beyond_the_message_is_refused_at_once() -> None:
    for ros in (1, 2):
        decoder = decoder_for(channel(ros, "tf2_msgs/msg/TFMessage"))
        data = bytearray(
            serialised(ros, ("", "tf2_msgs/msg/TFMessage", 0, Make(ros).transforms(STAMP, [])))
        )
        struct.pack_into("<I", data, len(data) - 4, 0xFFFFFFFF)
        with pytest.raises(LogError, match="a damaged tf2_msgs/msg/TFMessage"):
            decoder.message(bytes(data), 0).decode()


def test_decoding_waits_until_it_is_asked_for(tmp_path: Path) -> None:
    """A poisoned scan and a poisoned image disturb nobody who does not look at them."""
    from log_builders import write_mcap

    from formats.logs import open_log

    make = Make(2)
    image = make(
        "sensor_msgs/msg/Image", make.header(STAMP, "c"), 2000, 2000, "rgb8", 0, 6000,
        np.zeros(3, np.uint8),
    )  # fmt: skip
    compressed = make(
        "sensor_msgs/msg/CompressedImage", make.header(STAMP, "c"), "jpeg", np.zeros(50, np.uint8)
    )
    path = write_mcap(
        tmp_path / "a.mcap",
        [
            ("/image", "sensor_msgs/msg/Image", 1, image),
            ("/image/compressed", "sensor_msgs/msg/CompressedImage", 2, compressed),
        ],
    )
    raw, packed = open_log([path]).messages()
    assert raw.stamp_ns == packed.stamp_ns == STAMP
    for message in (raw, packed):
        picture = message.decode()  # the frame and the size, but no pixels yet
        assert picture.frame_id == "c"  # type: ignore[union-attr]
        with pytest.raises(LogError):
            picture.pixels()  # type: ignore[union-attr]


@pytest.mark.parametrize("ros", [1, 2])
def test_a_camera_that_repeats_itself_is_read_as_one_that_does_not(ros: int) -> None:
    name, make = "sensor_msgs/msg/CameraInfo", Make(ros)
    roi = make("sensor_msgs/msg/RegionOfInterest", 0, 0, 0, 0, False)
    repeating = decoder_for(channel(ros, name))
    for step, (width, focal) in enumerate([(640, 500.0), (640, 500.0), (640, 501.0), (320, 501.0)]):
        message = make(
            name, make.header(STAMP + step, "camera"), 480, width, "", np.zeros(0),
            np.full(9, focal), np.zeros(9), np.zeros(12), 0, 0, roi,
        )  # fmt: skip
        data = serialised(ros, ("", name, 0, message))
        found = repeating.message(data, 5).decode()
        assert found.stamp_ns == STAMP + step
        assert_same(found, decoder_for(channel(ros, name)).message(data, 5).decode())
