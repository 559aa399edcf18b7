"""Protobuf messages among the others of an MCAP file, with their definitions."""

from __future__ import annotations

from typing import Any

from google.protobuf.descriptor_pb2 import FileDescriptorSet
from google.protobuf.message import Message as ProtobufMessage

from formats.logs.channels import Channel
from formats.recording_files import LogWriter


class FoxgloveSink:
    """Adds messages of ours and of Foxglove's to an MCAP file."""

    def __init__(self, writer: LogWriter) -> None:
        self._writer = writer
        self._handles: dict[str, Any] = {}

    def write(self, topic: str, message: Any, log_time_ns: int) -> None:
        """One message, whose topic is announced with its first."""
        if not isinstance(message, ProtobufMessage):
            self._writer.write(topic, message, log_time_ns)
            return
        if topic not in self._handles:
            name, schema = message.DESCRIPTOR.full_name, definition(message)
            channel = Channel(topic, name, "protobuf", "protobuf", schema)
            self._handles[topic] = self._writer.sink.add(channel)
        data = message.SerializeToString(deterministic=True)
        self._writer.sink.write(self._handles[topic], max(0, log_time_ns), data)


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
