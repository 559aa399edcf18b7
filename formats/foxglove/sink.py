"""Protobuf messages as MCAP channels, with their definitions."""

from __future__ import annotations

from typing import Any

from google.protobuf.descriptor_pb2 import FileDescriptorSet

from formats.logs.channels import Channel
from formats.recording_sinks import McapSink


class FoxgloveSink:
    """Adds Foxglove's messages to an MCAP file that may hold other messages too."""

    def __init__(self, sink: McapSink) -> None:
        self._sink = sink
        self._handles: dict[str, Any] = {}

    def write(self, topic: str, message: Any, log_time_ns: int) -> None:
        """One message, whose topic is announced with its first."""
        if topic not in self._handles:
            name, schema = message.DESCRIPTOR.full_name, definition(message)
            self._handles[topic] = self._sink.add(
                Channel(topic, name, "protobuf", "protobuf", schema)
            )
        data = message.SerializeToString(deterministic=True)
        self._sink.write(self._handles[topic], max(0, log_time_ns), data)


def definition(message: Any) -> bytes:
    """The message's schema and all that it refers to, as a FileDescriptorSet."""
    files: dict[str, Any] = {}

    def add(descriptor: Any) -> None:
        if descriptor.name not in files:
            for needed in descriptor.dependencies:
                add(needed)
            files[descriptor.name] = descriptor

    add(message.DESCRIPTOR.file)
    found = FileDescriptorSet()
    for descriptor in files.values():
        descriptor.CopyToProto(found.file.add())
    return bytes(found.SerializeToString(deterministic=True))
