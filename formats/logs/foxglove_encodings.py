"""Foxglove messages out of their encodings: protobuf, JSON, ROS 1 and ROS 2."""

from __future__ import annotations

import re
from collections.abc import Callable
from dataclasses import replace
from types import SimpleNamespace
from typing import Any

from formats.bounds import LATEST_NS
from formats.logs.channels import Channel, Payload
from formats.logs.foxglove_decoders import CONVERTERS, foxglove_name, stamp_of
from formats.nested_text import json_from_text
from mapmyworld.errors import LogError
from mapmyworld.types import Message, MessageKind, TransformsMessage

_STAMP = re.compile(rb'"timestamp"\s*:\s*\{\s*"sec"\s*:\s*(\d+)\s*,\s*"nsec"\s*:\s*(\d+)\s*\}')
_HEAD_BYTES = 4096  # of a JSON message, in which its time stamp is looked for first

Parse = Callable[[bytes], Any]


def foxglove_decoder(
    channel: Channel,
) -> tuple[MessageKind, Callable[[Payload], int | None], Callable[[Payload, int], Message]] | None:
    """Kind, peek at the stamp, and decoder; None for what is no known Foxglove type.

    The decoder raises `LogError` for a damaged message.
    """
    name = foxglove_name(channel.type_name)
    parse = _parser(channel) if name else None
    if parse is None:
        return None
    kind, convert = CONVERTERS[name]
    static = channel.topic.rstrip("/").endswith("tf_static")

    def decode(data: Payload, log_time_ns: int) -> Message:
        try:
            message = convert(parse(bytes(data)))
        except Exception as error:  # three foreign parsers, each with errors of its own
            raise LogError(
                f"{channel.topic}: a damaged {channel.type_name} at log time "
                f"{log_time_ns * 1e-9:.3f} s: {error}"
            ) from error
        if isinstance(message, TransformsMessage) and static:
            return replace(message, static=True)
        return message

    def slow_stamp(data: Payload) -> int | None:
        try:
            return decode(data, 0).stamp_ns
        except LogError:
            return None

    if name == "FrameTransforms":
        return kind, slow_stamp, decode
    quick = {"protobuf": _protobuf_stamp, "json": _json_stamp}.get(channel.encoding)

    def stamp(data: Payload) -> int | None:
        found = quick(bytes(data)) if quick is not None else None
        return slow_stamp(data) if found is None else found

    return kind, stamp, decode


def _parser(channel: Channel) -> Parse | None:
    if channel.encoding == "json":
        return _parse_json
    try:
        if channel.encoding == "protobuf":
            return _protobuf_parser(channel)
        if channel.encoding in {"cdr", "ros1"} and channel.schema:
            return _ros_parser(channel)
    except Exception:  # a schema that its own library cannot take: the topic is passed over
        return None
    return None


def _parse_json(data: bytes) -> Any:
    return json_from_text(data, object_hook=lambda fields: SimpleNamespace(**fields))


def _protobuf_parser(channel: Channel) -> Parse:
    from google.protobuf import descriptor_pb2, descriptor_pool, message_factory

    files = descriptor_pb2.FileDescriptorSet.FromString(channel.schema)
    pool = descriptor_pool.DescriptorPool()
    waiting = {file.name: file for file in files.file}

    def add(name: str) -> None:
        file = waiting.pop(name, None)
        if file is None:
            return
        for needed in file.dependency:
            add(needed)
        pool.Add(file)

    for name in list(waiting):
        add(name)
    described = pool.FindMessageTypeByName(channel.type_name)
    parse: Parse = message_factory.GetMessageClass(described).FromString
    return parse


def _ros_parser(channel: Channel) -> Parse:
    from formats.logs.definitions import recorded_store

    store, name = recorded_store(channel), channel.type_name
    if channel.encoding == "ros1":
        return lambda data: store.deserialize_ros1(data, name)
    return lambda data: store.deserialize_cdr(data, name)


def _json_stamp(data: bytes) -> int | None:
    """The first time stamp, where it is written as Foxglove's own tools write it."""
    found = _STAMP.search(data, 0, _HEAD_BYTES)
    if found is None:
        return None
    return min(int(found.group(1)) * 1_000_000_000 + int(found.group(2)), LATEST_NS)


def _protobuf_stamp(data: bytes) -> int | None:
    """The time stamp, where it comes first (field 1, as in all these types)."""
    if len(data) < 2 or data[0] != 0x0A or data[1] > 0x7F or data[1] + 2 > len(data):
        return None
    from google.protobuf.timestamp_pb2 import Timestamp

    try:
        time = Timestamp.FromString(data[2 : 2 + data[1]])
    except Exception:  # damaged; decoding will say so
        return None
    return stamp_of(SimpleNamespace(timestamp=time))
