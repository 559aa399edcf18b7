"""ROS 1 bags: chunks of messages, read through one by one."""

from __future__ import annotations

import re
from pathlib import Path
from typing import BinaryIO

from formats.limits import limits
from formats.logs.block_files import DamagedBlockError, RecordScan
from formats.logs.channels import Block, Channel, Found, Index
from formats.logs.compression import MAX_DEFINITION_BYTES
from formats.logs.files import begins_about_as
from formats.logs.recorded_log import RecordedLog
from formats.logs.ros1_records import (
    MAGIC,
    MAX_HEADER_BYTES,
    OP_BAG_HEADER,
    OP_CHUNK,
    OP_CHUNK_INFO,
    OP_CONNECTION,
    OP_INDEX,
    OP_MESSAGE,
    U32,
    Fields,
    block_messages,
    field_u32,
    operation,
    parse_connection,
    parse_fields,
)
from mapmyworld.errors import LogError

_OLD_VERSIONS = {b"V1.0", b"V1.1", b"V1.2", b"V1.3"}


class Ros1Bag(RecordedLog):
    """A bag of version 2.0; raises `LogError` where it is none."""

    def _scan(self, source: BinaryIO) -> Index:
        start = source.read(len(MAGIC))
        if not begins_about_as(start, MAGIC) or start[8:12] in _OLD_VERSIONS:
            raise LogError(
                f"{self.path}: not a ROS 1 bag of version 2.0: if it is an older bag, "
                "`rosbag migrate` converts it"
            )
        return _BagScan(source, self.path).run()

    def _messages(self, source: BinaryIO, block: Block) -> list[Found]:
        source.seek(block.offset)
        return block_messages(source.read(block.length), dict[int, Channel]())


class _BagScan(RecordScan):
    """The state of one reading: chunks that the bag states, and those that its end lists."""

    # The length of a header of at most 96 bytes, that of its first field, and the kind of a chunk.
    beginning = re.compile(rb"(?=[\x0d-\x60]\0\0\0[\x04-\x40]\0\0\0.{0,64}?op=\x05)", re.DOTALL)

    def __init__(self, stream: BinaryIO, path: Path) -> None:
        super().__init__(stream, path)
        self.is_indexed = False
        self.stated = self.listed = 0

    def run(self) -> Index:
        """What the bag holds."""
        self.read_from(len(MAGIC))
        self.note_unclosed(lambda: self.is_indexed and self.stated == self.listed)
        self.index.details += self.details()
        return self.index

    def record(self, position: int) -> int:
        fields, start, length = self._head(position)
        op = operation(fields)
        after = start + length
        if length > (MAX_DEFINITION_BYTES if op == OP_CONNECTION else limits().chunk_bytes):
            raise DamagedBlockError(f"a record claims {length} bytes")
        if after > self.size and op != OP_CHUNK:
            raise DamagedBlockError("the file ends in a record")
        if op in {OP_CHUNK, OP_MESSAGE}:
            self.stream.seek(position)
            data = self.stream.read(after - position)
            self.index.add(block_messages(data, self.index.channels), position, len(data))
        elif op == OP_CONNECTION:
            key, channel = parse_connection(fields, self.stream.read(length))
            self.index.channels[key] = channel
        elif op == OP_BAG_HEADER:
            self.is_indexed = fields.get(b"index_pos", b"").strip(b"\0") != b""
            self.stated = field_u32(fields, b"chunk_count")
        elif op not in {OP_INDEX, OP_CHUNK_INFO}:
            raise DamagedBlockError("there is no record")
        if op == OP_CHUNK:
            name = fields.get(b"compression", b"").decode("ascii", "replace")
            self.note_chunk(name, length, field_u32(fields, b"size"))
            if after > self.size:
                raise DamagedBlockError("the file ends in a chunk")
        self.listed += op == OP_CHUNK_INFO
        return after

    def _head(self, position: int) -> tuple[Fields, int, int]:
        """Fields of the record at a position, and start and length of its data."""
        self.stream.seek(position)
        head = self.stream.read(4)
        if len(head) < 4:
            raise DamagedBlockError("the file ends in it")
        (length,) = U32(head)
        if length > min(MAX_HEADER_BYTES, self.size - position):
            raise DamagedBlockError(f"record header at byte {position} claims {length} bytes")
        fields = parse_fields(self.stream.read(length))
        tail = self.stream.read(4)
        if len(tail) < 4:
            raise DamagedBlockError("the file ends in it")
        return fields, position + 8 + length, int(U32(tail)[0])

    def credible(self, position: int, data: bytes) -> bool:
        (length,) = U32(data)
        try:
            fields = parse_fields(data[4 : 4 + length])
        except DamagedBlockError:
            return False
        return operation(fields) == OP_CHUNK and b"compression" in fields and b"size" in fields
