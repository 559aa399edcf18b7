"""Logs for tests, written by stock libraries: rosbags' writers and MCAP's own."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from pathlib import Path
from typing import Any, TypeVar

import numpy as np
from hypothesis import strategies as st
from mcap.writer import CompressionType, Writer
from rosbags.rosbag1 import Writer as Ros1Writer
from rosbags.rosbag2 import CompressionFormat, CompressionMode, StoragePlugin
from rosbags.rosbag2 import Writer as Rosbag2Writer
from rosbags.typesys import Stores, get_types_from_msg, get_typestore
from rosbags.typesys.store import Typestore

from mapmyworld.errors import LogError

T = TypeVar("T")


def allowed(read: Callable[[], T], *words: str) -> T | None:
    """What `read` gives; None where it raises LogError, whose message must hold the words."""
    try:
        return read()
    except LogError as error:
        if not all(word in str(error) for word in words):
            raise AssertionError(f"{error} does not say {words}") from error
    return None


PLACES = st.floats(0.0, 1.0, exclude_max=True)
"""Where in a file, as a share of its length."""


def changes(least: int = 0) -> st.SearchStrategy[list[tuple[float, int]]]:
    """Up to four damaged bytes: places and what comes there."""
    return st.lists(st.tuples(PLACES, st.integers(0, 255)), min_size=least, max_size=4)


def damaged(data: bytes, wrong: Sequence[tuple[float, int]], kept: float) -> bytes:
    """The first share of some bytes, with wrong ones among them."""
    spoilt = bytearray(data)
    for place, byte in wrong:
        spoilt[int(place * len(spoilt))] = byte
    return bytes(spoilt[: round(kept * len(spoilt))])


def store(ros: int) -> Typestore:
    """Standard types, tf's included, of ROS 1 or 2."""
    made = get_typestore(Stores.ROS1_NOETIC if ros == 1 else Stores.ROS2_HUMBLE)
    if "tf2_msgs/msg/TFMessage" not in made.fielddefs:
        text = "geometry_msgs/TransformStamped[] transforms\n"
        made.register(get_types_from_msg(text, "tf2_msgs/msg/TFMessage"))
    return made


STORES = {1: store(1), 2: store(2)}
Built = tuple[str, str, int, Any]
"""Topic, type, log time, message object."""


class Make:
    """Message objects of one ROS version."""

    def __init__(self, ros: int) -> None:
        self.ros, self.types = ros, STORES[ros].types

    def __call__(self, name: str, *values: Any) -> Any:
        return self.types[name](*values)

    def header(self, stamp_ns: int, frame: str = "base") -> Any:
        time = self("builtin_interfaces/msg/Time", *divmod(stamp_ns, 1_000_000_000))
        return self("std_msgs/msg/Header", *((7,) if self.ros == 1 else ()), time, frame)

    def scan(self, stamp_ns: int, ranges: Sequence[float] = (1.0, 2.5, 3.0)) -> Any:
        values = np.array(ranges, np.float32)
        return self(
            "sensor_msgs/msg/LaserScan", self.header(stamp_ns, "laser"),
            -1.5, 1.5, 0.25, 0.001, 0.1, 0.05, 30.0, values, values * 10,
        )  # fmt: skip

    def pose(self, x: float = 1.0, quaternion: Sequence[float] = (0, 0, 0.6, 0.8)) -> Any:
        return self(
            "geometry_msgs/msg/Pose",
            self("geometry_msgs/msg/Point", x, 2.0, 3.0),
            self("geometry_msgs/msg/Quaternion", *quaternion),
        )

    def vector(self, x: float, y: float, z: float) -> Any:
        return self("geometry_msgs/msg/Vector3", x, y, z)

    def odometry(self, stamp_ns: int, child: str = "base_link") -> Any:
        covariance = np.arange(36.0)
        twist = self("geometry_msgs/msg/Twist", self.vector(1, 2, 3), self.vector(4, 5, 6))
        return self(
            "nav_msgs/msg/Odometry",
            self.header(stamp_ns, "odom"),
            child,
            self("geometry_msgs/msg/PoseWithCovariance", self.pose(), covariance),
            self("geometry_msgs/msg/TwistWithCovariance", twist, covariance + 0.5),
        )

    def transforms(self, stamp_ns: int, names: Sequence[tuple[str, str]]) -> Any:
        rotation = self("geometry_msgs/msg/Quaternion", 0.0, 0.0, 0.6, 0.8)
        transform = self("geometry_msgs/msg/Transform", self.vector(1, 2, 3), rotation)
        stamped = [
            self(
                "geometry_msgs/msg/TransformStamped",
                self.header(stamp_ns, parent),
                child,
                transform,
            )
            for parent, child in names
        ]
        return self("tf2_msgs/msg/TFMessage", stamped)

    def text(self, value: str) -> Any:
        return self("std_msgs/msg/String", value)


def serialised(ros: int, built: Built) -> bytes:
    _, name, _, message = built
    if ros == 1:
        return bytes(STORES[1].serialize_ros1(message, name))
    return bytes(STORES[2].serialize_cdr(message, name))


def write_ros1(
    path: Path, messages: Iterable[Built], compression: str = "none", chunk_bytes: int = 1 << 20
) -> Path:
    writer = Ros1Writer(path)
    if compression != "none":
        writer.set_compression(Ros1Writer.CompressionFormat[compression.upper()])
    writer.chunk_threshold = chunk_bytes
    with writer:
        connections: dict[tuple[str, str], Any] = {}
        for built in messages:
            topic, name, time, _ = built
            if (topic, name) not in connections:
                connections[topic, name] = writer.add_connection(topic, name, typestore=STORES[1])
            writer.write(connections[topic, name], time, serialised(1, built))
    return path


def write_rosbag2(
    path: Path, messages: Iterable[Built], storage: str = "sqlite3", mode: str = "none"
) -> Path:
    writer = Rosbag2Writer(path, version=9, storage_plugin=StoragePlugin[storage.upper()])
    writer.set_compression(CompressionMode[mode.upper()], CompressionFormat.ZSTD)
    with writer:
        connections: dict[tuple[str, str], Any] = {}
        for built in messages:
            topic, name, time, _ = built
            if (topic, name) not in connections:
                connections[topic, name] = writer.add_connection(topic, name, typestore=STORES[2])
            writer.write(connections[topic, name], time, serialised(2, built))
    return path


COMPRESSIONS = {
    "none": CompressionType.NONE,
    "lz4": CompressionType.LZ4,
    "zstd": CompressionType.ZSTD,
}


def write_mcap(
    path: Path,
    messages: Iterable[Built],
    *,
    ros: int = 2,
    compression: str = "zstd",
    chunk_bytes: int = 1 << 20,
    schema_encoding: str = "",
    **options: Any,
) -> Path:
    """A lone MCAP file of ROS 1 or ROS 2 messages; further options go to MCAP's writer."""
    with path.open("wb") as stream:
        writer = Writer(stream, chunk_bytes, COMPRESSIONS[compression], **options)
        writer.start("ros1" if ros == 1 else "ros2", "test")
        channels: dict[tuple[str, str], int] = {}
        for built in messages:
            topic, name, time, _ = built
            if (topic, name) not in channels:
                text, _ = STORES[ros].generate_msgdef(name, ros_version=ros)
                shown = name.replace("/msg/", "/") if ros == 1 else name
                encoding = schema_encoding or ("ros1msg" if ros == 1 else "ros2msg")
                schema = writer.register_schema(shown, encoding, text.encode())
                coding = "ros1" if ros == 1 else "cdr"
                channels[topic, name] = writer.register_channel(topic, coding, schema)
            writer.add_message(channels[topic, name], time, serialised(ros, built), time)
        writer.finish()
    return path


def drive(
    ros: int, count: int = 40, step_ns: int = 10_000_000, start_ns: int = 10**18
) -> list[Built]:
    """A little of everything a robot with a laser records, in time order, with ties."""
    make, found = Make(ros), list[Built]()
    pair = [("base_link", "laser")]
    found.append(
        ("/tf_static", "tf2_msgs/msg/TFMessage", start_ns, make.transforms(start_ns, pair))
    )
    for i in range(count):
        t = start_ns + i * step_ns
        found.append(("/odom", "nav_msgs/msg/Odometry", t, make.odometry(t)))
        found.append(("/scan", "sensor_msgs/msg/LaserScan", t, make.scan(t, np.arange(30) + i)))
        if i % 4 == 0:
            found.append(("/chatter", "std_msgs/msg/String", t + 1, make.text(f"message {i}")))
    return found
