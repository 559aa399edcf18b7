"""Records of an MCAP file: opcode, length, content.

Format: https://mcap.dev/spec
"""

from __future__ import annotations

import struct
from collections.abc import Mapping
from dataclasses import dataclass
from struct import Struct

from formats.logs.block_files import DamagedBlockError
from formats.logs.channels import Channel, Payload, normalised_type, payload

MAGIC = b"\x89MCAP0\r\n"
HEADER, FOOTER, SCHEMA, CHANNEL, MESSAGE, CHUNK, MESSAGE_INDEX, CHUNK_INDEX = range(1, 9)
ATTACHMENT, ATTACHMENT_INDEX, STATISTICS, METADATA, METADATA_INDEX, SUMMARY_OFFSET, DATA_END = (
    range(9, 16)
)
HEAD_BYTES = 9  # opcode and length
FOOTER_BYTES = HEAD_BYTES + 20 + len(MAGIC)
_HEAD = Struct("<BQ").unpack_from
_MESSAGE_HEAD = Struct("<BQHIQ").unpack_from
_MESSAGE_BYTES = HEAD_BYTES + 22
_U16, _U32, _U64 = Struct("<H"), Struct("<I"), Struct("<Q")
_CHUNK = Struct("<QQQI")
_CHUNK_INDEX = Struct("<QQQQ")
_STATISTICS = Struct("<QHIIIIQQ")
_PAIR = Struct("<HQ")


class Cursor:
    """Reads little-endian values one after another; DamagedBlockError at the end of the data."""

    def __init__(self, data: bytes) -> None:
        self.data, self.position = data, 0

    def values(self, layout: Struct) -> tuple[int, ...]:
        """The next numbers."""
        try:
            found = layout.unpack_from(self.data, self.position)
        except struct.error as error:
            raise DamagedBlockError("a record is cut") from error
        self.position += layout.size
        return found

    def number(self, layout: Struct) -> int:
        """The next number."""
        return self.values(layout)[0]

    def take(self, size: int) -> bytes:
        """The next bytes."""
        if self.position + size > len(self.data):
            raise DamagedBlockError("a record is cut")
        self.position += size
        return self.data[self.position - size : self.position]

    def text(self) -> str:
        """A string with its length before it."""
        return self.take(self.number(_U32)).decode("utf-8", "replace")

    def text_map(self) -> dict[str, str]:
        """Pairs of strings with their length in bytes before them."""
        end = self.number(_U32) + self.position
        found: dict[str, str] = {}
        while self.position < end:
            name = self.text()
            found[name] = self.text()
        return found


@dataclass(frozen=True, slots=True)
class Schema:
    """A type's definition, as recorded."""

    name: str
    encoding: str
    data: bytes


def parse_schema(content: bytes) -> tuple[int, Schema]:
    """The schema and its number."""
    cursor = Cursor(content)
    key, name, encoding = cursor.number(_U16), cursor.text(), cursor.text()
    return key, Schema(name, encoding, cursor.take(cursor.number(_U32)))


def parse_channel(content: bytes, schemas: Mapping[int, Schema]) -> tuple[int, Channel]:
    """Id and channel; one whose schema is not known gets an empty type."""
    cursor = Cursor(content)
    key, schema_id = cursor.number(_U16), cursor.number(_U16)
    topic, encoding, metadata = cursor.text(), cursor.text(), cursor.text_map()
    schema = schemas.get(schema_id, Schema("", "", b""))
    profiles = metadata.get("offered_qos_profiles", "")
    channel = Channel(
        topic,
        normalised_type(schema.name),
        encoding,
        schema.encoding,
        schema.data,
        metadata.get("topic_type_hash", ""),
        metadata.get("latching") in {"1", "true"} or is_transient_local(profiles),
        metadata,
    )
    return key, channel


def is_transient_local(profiles: str) -> bool:
    """Whether a QoS profile, as rosbag2 writes it, says that messages hold for late joiners."""
    words = profiles.replace(" ", "")
    return "durability:1" in words or "durability:transient_local" in words


@dataclass(frozen=True, slots=True)
class ChunkHead:
    """What stands before a chunk's data."""

    start_ns: int
    end_ns: int
    size: int
    crc: int
    compression: str
    data_at: int
    """Where the compressed bytes start in the record's content."""
    data_bytes: int


def parse_chunk_head(content: bytes) -> ChunkHead:
    """Of a chunk record's first bytes."""
    cursor = Cursor(content)
    start, end, size, crc = cursor.values(_CHUNK)
    compression = cursor.text()
    length = cursor.number(_U64)
    return ChunkHead(start, end, size, crc, compression, cursor.position, length)


@dataclass(frozen=True, slots=True)
class ChunkIndexRecord:
    """An entry of the summary's list of chunks."""

    start_ns: int
    end_ns: int
    offset: int
    channels: frozenset[int] | None
    compression: str
    compressed_size: int
    size: int


def parse_chunk_index(content: bytes) -> ChunkIndexRecord:
    """Where a chunk is and what it holds; None as channels where it does not say."""
    cursor = Cursor(content)
    start, end, offset, _ = cursor.values(_CHUNK_INDEX)
    offsets = dict(_pairs(cursor))
    cursor.number(_U64)
    compression = cursor.text()
    compressed, size = cursor.number(_U64), cursor.number(_U64)
    channels = frozenset(offsets) or None
    return ChunkIndexRecord(start, end, offset, channels, compression, compressed, size)


def _pairs(cursor: Cursor) -> list[tuple[int, int]]:
    data = cursor.take(cursor.number(_U32))
    return [(int(k), int(v)) for k, v in _PAIR.iter_unpack(data[: len(data) // 10 * 10])]


@dataclass(frozen=True, slots=True)
class Statistics:
    """What a finished file reports about itself."""

    messages: int
    chunks: int
    start_ns: int
    end_ns: int
    counts: dict[int, int]


def parse_statistics(content: bytes) -> Statistics:
    """The counts that a finished file ends with."""
    cursor = Cursor(content)
    messages, _, _, _, _, chunks, start, end = cursor.values(_STATISTICS)
    return Statistics(messages, chunks, start, end, dict(_pairs(cursor)))


def parse_header(content: bytes) -> tuple[str, str]:
    """Profile and library."""
    cursor = Cursor(content)
    return cursor.text(), cursor.text()


class Definitions:
    """Schemas and channels gathered while records go by."""

    def __init__(self) -> None:
        self.schemas: dict[int, Schema] = {}
        self.channels: dict[int, Channel] = {}

    def take(self, opcode: int, content: bytes) -> None:
        """The next bytes."""
        if opcode == SCHEMA:
            key, schema = parse_schema(content)
            self.schemas[key] = schema
        elif opcode == CHANNEL:
            key, channel = parse_channel(content, self.schemas)
            self.channels.setdefault(key, channel)


def chunk_messages(
    data: bytes,
    wanted: Mapping[int, object] | None,
    definitions: Definitions | None = None,
    *,
    to_the_end: bool = True,
) -> list[tuple[int, int, Payload]]:
    """Messages of decompressed records as (log time, channel id, payload), in file order.

    `wanted` None means all. Definitions met on the way go into `definitions`. Where `to_the_end`
    is False, damage ends the list instead of raising DamagedBlockError.
    """
    messages: list[tuple[int, int, Payload]] = []
    position, end = 0, len(data)
    try:
        while position < end:
            position = _next_record(data, position, end, wanted, definitions, messages)
    except DamagedBlockError:
        if to_the_end:
            raise
    return messages


def _next_record(
    data: bytes,
    position: int,
    end: int,
    wanted: Mapping[int, object] | None,
    definitions: Definitions | None,
    messages: list[tuple[int, int, Payload]],
) -> int:
    if data[position] == MESSAGE and position + _MESSAGE_BYTES <= end:
        _, length, key, _, time = _MESSAGE_HEAD(data, position)
        after: int = position + HEAD_BYTES + length
        if after > end or length < 22:
            raise DamagedBlockError("a message is cut")
        if wanted is None or key in wanted:
            messages.append((time, key, payload(data, position + _MESSAGE_BYTES, after)))
        return after
    if position + HEAD_BYTES > end:
        raise DamagedBlockError("a record is cut")
    opcode, length = _HEAD(data, position)
    after = position + HEAD_BYTES + length
    if after > end or (opcode not in {SCHEMA, CHANNEL} and opcode < 0x80):
        raise DamagedBlockError("a record is cut or unknown")
    if definitions is not None:
        definitions.take(opcode, data[position + HEAD_BYTES : after])
    return after


def record_head(data: bytes, position: int = 0) -> tuple[int, int]:
    """Opcode and content length of the record at `position`."""
    opcode, length = _HEAD(data, position)
    return int(opcode), int(length)
