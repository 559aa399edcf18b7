"""Records of an MCAP file: opcode, length, content.

Format: https://mcap.dev/spec
"""

from __future__ import annotations

from dataclasses import dataclass
from io import BytesIO
from struct import Struct
from typing import TypeVar

from isal.isal_zlib import crc32  # ten times as fast as zlib's
from mcap import records
from mcap.data_stream import ReadDataStream

from formats.logs.block_files import DamagedBlockError, messages_of
from formats.logs.channels import Channel, Found, normalised_type
from formats.logs.compression import decompress, decompress_beginning

MAGIC = b"\x89MCAP0\r\n"
HEADER, SCHEMA, CHANNEL, MESSAGE, CHUNK, DATA_END = 1, 3, 4, 5, 6, 15
HEAD_BYTES = 9  # opcode and length
_HEAD = Struct("<BQ").unpack_from
MESSAGE_HEAD = Struct("<HIQQ")  # channel, sequence, log time, publish time
_NO_SCHEMA = records.Schema(0, b"", "", "")
Parsed = TypeVar("Parsed", bound=records.McapRecord)


class _Record(ReadDataStream):
    """A record's content, for the readers of `mcap`, which take what is cut for what is short."""

    def __init__(self, content: bytes) -> None:
        super().__init__(BytesIO(content))

    def read(self, length: int) -> bytes:
        data = self._stream.read(length)
        if len(data) < length:
            raise DamagedBlockError("a record is cut")
        self._count += length
        return data


def parsed(kind: type[Parsed], content: bytes) -> Parsed:
    """A record of `mcap.records`; DamagedBlockError where the content holds none."""
    try:
        return kind.read(_Record(content))  # type: ignore[attr-defined, no-any-return]
    except UnicodeDecodeError as error:
        raise DamagedBlockError("a record's text is no UTF-8") from error


def _channel(found: records.Channel, schema: records.Schema) -> Channel:
    """Ours; a schema that is not known is an empty one."""
    profiles = found.metadata.get("offered_qos_profiles", "")
    return Channel(
        found.topic,
        normalised_type(schema.name),
        found.message_encoding,
        schema.encoding,
        schema.data,
        found.metadata.get("topic_type_hash", ""),
        found.metadata.get("latching") in {"1", "true"} or is_transient_local(profiles),
        found.metadata,
    )


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
    stream = _Record(content)
    times_and_size = stream.read8(), stream.read8(), stream.read8()
    crc, name = stream.read4(), stream.read(stream.read4()).decode("utf-8", "replace")
    length = stream.read8()
    return ChunkHead(*times_and_size, crc, name, stream.count, length)


class Definitions:
    """Schemas and channels gathered while records go by."""

    def __init__(self) -> None:
        self.schemas: dict[int, records.Schema] = {}
        self.channels: dict[int, Channel] = {}

    def take(self, opcode: int, content: bytes) -> None:
        """The next record."""
        if opcode == SCHEMA:
            schema = parsed(records.Schema, content)
            self.schemas[schema.id] = schema
        elif opcode == CHANNEL:
            found = parsed(records.Channel, content)
            schema = self.schemas.get(found.schema_id, _NO_SCHEMA)
            self.channels.setdefault(found.id, _channel(found, schema))


def block_messages(data: bytes, definitions: Definitions) -> list[Found]:
    """Messages of a chunk, or of a run of them outside of any, in file order.

    Of a chunk in which the file ends, those that can be had. Definitions met on the way go into
    `definitions`. DamagedBlockError where something is wrong.
    """
    opcode, length = record_head(data)
    if opcode != CHUNK:
        return messages_of(data, _next_record, definitions)
    head = parse_chunk_head(data[HEAD_BYTES : HEAD_BYTES + 128])
    stored = memoryview(data)[HEAD_BYTES + head.data_at :]
    if len(data) < HEAD_BYTES + length:
        plain = decompress_beginning(stored, head.compression, head.size)
        return messages_of(plain, _next_record, definitions, to_the_end=False)
    plain = decompress(stored, head.compression, head.size)
    if head.crc and crc32(plain) != head.crc:
        raise DamagedBlockError("its checksum is wrong")
    return messages_of(plain, _next_record, definitions)


def _next_record(
    data: bytes, position: int, definitions: Definitions, messages: list[Found]
) -> int:
    start = position + HEAD_BYTES
    if start > len(data):
        raise DamagedBlockError("a record is cut")
    opcode, length = _HEAD(data, position)
    after: int = start + length
    if after > len(data) or (opcode not in {SCHEMA, CHANNEL, MESSAGE} and opcode < 0x80):
        raise DamagedBlockError("a record is cut or unknown")
    if opcode == MESSAGE:
        if length < MESSAGE_HEAD.size:
            raise DamagedBlockError("a message is cut")
        key, _, time, _ = MESSAGE_HEAD.unpack_from(data, start)
        messages.append((time, key, data[start + MESSAGE_HEAD.size : after]))
    else:
        definitions.take(opcode, data[start:after])
    return after


def record_head(data: bytes, position: int = 0) -> tuple[int, int]:
    """Opcode and content length of the record at `position`."""
    opcode, length = _HEAD(data, position)
    return int(opcode), int(length)
