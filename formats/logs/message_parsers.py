"""Messages out of their encodings, as objects with their fields as attributes."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass
from functools import lru_cache
from types import SimpleNamespace
from typing import Any

from rosbags.interfaces import Nodetype
from rosbags.typesys.store import Typestore

from formats.logs.channels import Channel, Payload
from formats.logs.definitions import HEADER, recorded_store, standard_store
from formats.nested_text import json_from_text

Parse = Callable[[Payload], Any]
_CDR_HEAD = 4  # bytes that name the encapsulation


def parser_of(channel: Channel) -> Parse | None:
    """What raises anything for a damaged message; None where the schema cannot be taken."""
    if channel.encoding in {"ros1", "cdr"}:
        described = channel.encoding, channel.type_name, channel.schema_encoding, channel.schema
        return _ros_parser(*described)
    if channel.encoding == "json":
        return _parse_json
    if channel.encoding == "protobuf":
        try:
            return _protobuf_parser(channel)
        except Exception:  # a schema that its own library cannot take: the topic is passed over
            return None
    return None


def _parse_json(data: Payload) -> Any:
    return json_from_text(bytes(data), object_hook=lambda fields: SimpleNamespace(**fields))


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
    return lambda data: made.FromString(bytes(data))


@dataclass(frozen=True, slots=True, eq=False)
class RosParser:
    """By rosbags, for one type as its definition lays it out."""

    store: Typestore
    type_name: str
    is_ros1: bool

    def __call__(self, data: Payload) -> Any:
        made = self.store.get_msgdef(self.type_name)
        if self.is_ros1:
            return _whole(*made.deserialize_ros1(data, 0, made.cls, self.store), len(data))
        if bytes(data[:2]) not in (b"\x00\x00", b"\x00\x01"):
            raise ValueError(f"encapsulation {bytes(data[:4]).hex()} is not plain CDR")
        read = made.deserialize_cdr_le if data[1] else made.deserialize_cdr_be
        body = data[_CDR_HEAD:]
        return _whole(*read(body, 0, made.cls, self.store), len(body))

    def stamp_at(self) -> int | None:
        """Where the seconds of a message's first header stand; None where it begins otherwise."""
        first: Any = self.store.fielddefs[self.type_name][1][0][1]
        listed = first[0] == Nodetype.SEQUENCE and first[1][0][0] == Nodetype.NAME
        if listed:  # of tf
            first = self.store.fielddefs[first[1][0][1]][1][0][1]
        standard = standard_store("ros1" if self.is_ros1 else "cdr")
        same = self.store.fielddefs[HEADER] == standard.fielddefs[HEADER]
        if first != (Nodetype.NAME, HEADER) or not same:
            return None
        return 8 if listed else 4  # behind the sequence number, or the encapsulation


def _whole(message: Any, end: int, size: int) -> Any:
    """The message, unless it goes on behind its bytes; bytes behind it do no harm."""
    if end > size:
        raise ValueError(f"{end} bytes are announced, {size} are there")
    return message


@lru_cache(maxsize=256)  # to make the code that reads a type takes some milliseconds
def _ros_parser(
    encoding: str, type_name: str, schema_encoding: str, schema: bytes
) -> RosParser | None:
    """By the recorded definition, or the standard one where that cannot be read."""
    store = standard_store(encoding)
    if schema.strip():
        with suppress(Exception):  # everything is raised at a text that is no definition
            store = recorded_store(Channel("", type_name, encoding, schema_encoding, schema))
    return RosParser(store, type_name, encoding == "ros1") if type_name in store.types else None
