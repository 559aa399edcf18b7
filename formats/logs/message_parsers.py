"""Messages out of their encodings, as objects with their fields as attributes."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import suppress
from functools import lru_cache, partial
from types import SimpleNamespace
from typing import Any

from rosbags.interfaces import Nodetype
from rosbags.typesys.store import Typestore

from formats.logs.channels import Channel
from formats.logs.definitions import HEADER, recorded_store, standard_store
from formats.nested_text import json_from_text

Parse = Callable[[bytes], Any]
_CDR_HEAD = 4  # bytes that name the encapsulation


def parser_of(channel: Channel) -> Parse | None:
    """What raises anything for a damaged message; None where the schema cannot be taken."""
    if channel.encoding in {"ros1", "cdr"}:
        described = channel.encoding, channel.type_name, channel.schema_encoding, channel.schema
        return _ros_parser(*described)
    if channel.encoding == "json":
        return partial(json_from_text, object_hook=lambda fields: SimpleNamespace(**fields))
    if channel.encoding == "protobuf":
        try:
            return _protobuf_parser(channel)
        except Exception:  # a schema that its own library cannot take: the topic is passed over
            return None
    return None


def _protobuf_parser(channel: Channel) -> Parse:
    from google.protobuf import (
        descriptor_database,
        descriptor_pb2,
        descriptor_pool,
        message_factory,
    )

    files = descriptor_pb2.FileDescriptorSet.FromString(channel.schema)
    known = descriptor_database.DescriptorDatabase()
    for file in files.file:
        known.Add(file)
    pool = descriptor_pool.DescriptorPool(known)
    made = message_factory.GetMessageClass(pool.FindMessageTypeByName(channel.type_name))
    parse: Parse = made.FromString
    return parse


def _parse_ros(store: Typestore, type_name: str, is_ros1: bool, data: bytes) -> Any:
    """By rosbags, as the type's definition lays it out."""
    made = store.get_msgdef(type_name)
    if is_ros1:
        return _whole(*made.deserialize_ros1(data, 0, made.cls, store), len(data))
    if data[:2] not in (b"\x00\x00", b"\x00\x01"):
        raise ValueError(f"encapsulation {data[:4].hex()} is not plain CDR")
    read = made.deserialize_cdr_le if data[1] else made.deserialize_cdr_be
    body = memoryview(data)[_CDR_HEAD:]
    return _whole(*read(body, 0, made.cls, store), len(body))


def _whole(message: Any, end: int, size: int) -> Any:
    """The message, unless it goes on behind its bytes; bytes behind it do no harm."""
    if end > size:
        raise ValueError(f"{end} bytes are announced, {size} are there")
    return message


@lru_cache(maxsize=256)  # to make the code that reads a type takes some milliseconds
def _ros_parser(encoding: str, type_name: str, schema_encoding: str, schema: bytes) -> Parse | None:
    """By the recorded definition, or the standard one where that cannot be read."""
    store = None
    if schema.strip():
        with suppress(Exception):  # everything is raised at a text that is no definition
            store = recorded_store(Channel("", type_name, encoding, schema_encoding, schema))
    store = store or standard_store(encoding)
    known = type_name in store.types
    return partial(_parse_ros, store, type_name, encoding == "ros1") if known else None


def header_parser_of(channel: Channel) -> Parse | None:
    """What parses the ROS header that messages of the channel begin with; None where none does.

    Most messages are read for their stamp alone, and their header is a tenth of the work.
    """
    parse = parser_of(channel)
    if not (isinstance(parse, partial) and parse.func is _parse_ros):
        return None
    store, type_name, is_ros1 = parse.args
    name, (kind, first) = store.fielddefs[type_name][1][0]
    begins = name == "header" and kind is Nodetype.NAME and first == HEADER
    return partial(_parse_ros, store, HEADER, is_ros1) if begins else None
