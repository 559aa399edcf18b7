"""Where serialised messages go: an MCAP file, a ROS 1 bag, a rosbag2 recording."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from mcap.writer import CompressionType
from mcap.writer import Writer as McapWriter
from rosbags.interfaces import (
    Qos,
    QosDurability,
    QosHistory,
    QosLiveliness,
    QosReliability,
    QosTime,
)
from rosbags.rosbag1 import Writer as Ros1Writer
from rosbags.rosbag2 import CompressionFormat, CompressionMode, StoragePlugin
from rosbags.rosbag2 import Writer as Rosbag2Writer
from rosbags.rosbag2.metadata import dump_qos_v8

import mapmyworld
from formats.logs.channels import Channel
from mapmyworld.errors import LogError

Handle = Any
"""What a sink gives for a channel, to write with."""

_CHUNK_BYTES = 1 << 20
_FOREVER = QosTime(2147483647, 4294967295)
# The profile of a topic whose messages hold for those who come late, as /tf_static's do.
LATCHED = Qos(
    QosHistory.KEEP_LAST,
    1,
    QosReliability.RELIABLE,
    QosDurability.TRANSIENT_LOCAL,
    _FOREVER,
    _FOREVER,
    QosLiveliness.AUTOMATIC,
    _FOREVER,
    avoid_ros_namespace_conventions=False,
)


class McapSink:
    """A lone .mcap file; takes messages of any encoding."""

    encoding = "cdr"

    def __init__(self, path: Path, compression: str) -> None:
        self.path = path
        self._stream = path.open("wb")
        kind = CompressionType[compression.upper()]
        self._writer = McapWriter(self._stream, _CHUNK_BYTES, kind)
        self._writer.start("ros2", f"mapmyworld {mapmyworld.__version__}")
        self._schemas: dict[tuple[str, str, bytes], int] = {}
        self._sequences: dict[int, int] = {}

    def add(self, channel: Channel) -> Handle:
        """Makes a topic known; what it gives stands for the topic in `write`."""
        name = channel.type_name
        if channel.encoding == "ros1":
            name = name.replace("/msg/", "/")
        key = (name, channel.schema_encoding, channel.schema)
        if name and key not in self._schemas:
            self._schemas[key] = self._writer.register_schema(*key)
        metadata = dict(channel.metadata)
        if channel.encoding == "ros1":
            metadata |= {"md5sum": channel.digest} if channel.digest else {}
            metadata |= {"latching": "1"} if channel.latching else {}
        elif channel.latching:
            metadata.setdefault("offered_qos_profiles", dump_qos_v8([LATCHED]))
        return self._writer.register_channel(
            channel.topic, channel.encoding, self._schemas.get(key, 0), metadata
        )

    def write(self, handle: Handle, log_time_ns: int, data: bytes) -> None:
        sequence = self._sequences[handle] = self._sequences.get(handle, -1) + 1
        self._writer.add_message(handle, log_time_ns, data, log_time_ns, sequence)

    def close(self) -> Path:
        """The whole file."""
        with self._stream:
            self._writer.finish()  # type: ignore[no-untyped-call]
        return self.path


class Ros1Sink:
    """A ROS 1 bag."""

    encoding = "ros1"

    def __init__(self, path: Path, compression: str) -> None:
        self.path = path
        self._writer = Ros1Writer(path)
        if compression != "none":
            self._writer.set_compression(Ros1Writer.CompressionFormat[compression.upper()])
        self._writer.open()
        self._connections: dict[tuple[str, str, str, str], Handle] = {}

    def add(self, channel: Channel) -> Handle:
        caller = channel.metadata.get("callerid", "")
        key = (channel.topic, channel.type_name, channel.digest, caller)
        if key not in self._connections:
            self._connections[key] = self._writer.add_connection(
                channel.topic,
                channel.type_name,
                msgdef=channel.schema.decode("utf-8", "replace"),
                md5sum=channel.digest or "*",
                callerid=caller or None,
                latching=1 if channel.latching else None,
            )
        return self._connections[key]

    def write(self, handle: Handle, log_time_ns: int, data: bytes) -> None:
        """A message at its log time; raises `LogError` for a time that a ROS 1 bag cannot hold."""
        if not 0 <= log_time_ns < 1_000_000_000 << 32:
            raise LogError(f"{self.path.name}: a ROS 1 bag cannot hold the time {log_time_ns} ns")
        self._writer.write(handle, log_time_ns, data)

    def close(self) -> Path:
        """The whole file."""
        self._writer.close()
        return self.path


class Rosbag2Sink:
    """A rosbag2 folder with a .db3 file in it; a path ending in .db3 becomes that file alone."""

    encoding = "cdr"

    def __init__(self, path: Path, compression: str) -> None:
        self.path = path  # whose name the file in it bears as well
        self._alone = path.suffix == ".db3"
        sqlite = StoragePlugin.SQLITE3
        self._writer = Rosbag2Writer(path, version=9, storage_plugin=sqlite)
        if compression == "zstd":
            mode = CompressionMode.MESSAGE if self._alone else CompressionMode.FILE
            self._writer.set_compression(mode, CompressionFormat.ZSTD)
        self._writer.open()
        self._connections: dict[tuple[str, str], Handle] = {}

    def add(self, channel: Channel) -> Handle:
        key = (channel.topic, channel.type_name)
        if key not in self._connections:
            self._connections[key] = self._writer.add_connection(
                channel.topic,
                channel.type_name,
                msgdef=channel.schema.decode("utf-8", "replace"),
                rihs01=channel.digest or "RIHS01_",
                serialization_format=channel.encoding,
                offered_qos_profiles=[LATCHED] if channel.latching else [],
            )
        return self._connections[key]

    def write(self, handle: Handle, log_time_ns: int, data: bytes) -> None:
        self._writer.write(handle, log_time_ns, data)

    def close(self) -> Path:
        """The whole folder, or the file in it."""
        self._writer.close()
        return next(self.path.glob("*.db3")) if self._alone else self.path


Sink = McapSink | Ros1Sink | Rosbag2Sink
"""A container that messages are written to; it takes those of its `encoding`."""

SINKS: dict[str, type[Sink]] = {".mcap": McapSink, ".bag": Ros1Sink, ".db3": Rosbag2Sink}
"""By the ending of a log's name."""
