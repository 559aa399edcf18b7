"""MCAP files: chunks of messages, or messages alone, read through record by record."""

from __future__ import annotations

import re
from pathlib import Path
from struct import Struct
from typing import BinaryIO

from isal.isal_zlib import crc32
from mcap.records import Header

from formats.limits import limits
from formats.logs.block_files import DamagedBlockError, RecordScan
from formats.logs.channels import Block, Found, Index
from formats.logs.compression import MAX_DEFINITION_BYTES
from formats.logs.files import begins_about_as
from formats.logs.mcap_records import (
    CHANNEL,
    CHUNK,
    DATA_END,
    HEAD_BYTES,
    HEADER,
    MAGIC,
    MESSAGE,
    MESSAGE_HEAD,
    SCHEMA,
    Definitions,
    block_messages,
    parse_chunk_head,
    parsed,
    record_head,
)
from formats.logs.recorded_log import RecordedLog
from mapmyworld.errors import LogError

_FOOTER = Struct("<QQI")  # where the summary begins, and its parts' offsets; its checksum
_FOOTER_BYTES = HEAD_BYTES + _FOOTER.size + len(MAGIC)
_RUN_BYTES = 1 << 20  # bare messages gathered into one block
_DAY_NS = 86_400_000_000_000
_COMPRESSIONS = {"", "none", "lz4", "zstd"}


class McapFile(RecordedLog):
    """An MCAP file; raises `LogError` where it is none."""

    def _scan(self, source: BinaryIO) -> Index:
        if not begins_about_as(source.read(len(MAGIC)), MAGIC):
            raise LogError(f"{self.path}: not an MCAP file: its first bytes are not MCAP's")
        return _McapScan(source, self.path).run()

    def _messages(self, source: BinaryIO, block: Block) -> list[Found]:
        source.seek(block.offset)
        data = source.read(block.length)
        if len(data) < block.length:
            raise DamagedBlockError("it is shorter")
        return block_messages(data, Definitions())


class _McapScan(RecordScan):
    """The state of one reading: what is defined, and the block being gathered."""

    # A chunk, message or end-of-data record whose length is below 2^40.
    beginning = re.compile(rb"[\x05\x06\x0f].{5}\x00\x00\x00", re.DOTALL)

    def __init__(self, stream: BinaryIO, path: Path) -> None:
        super().__init__(stream, path)
        self.definitions = Definitions()
        self.index.channels = self.definitions.channels
        self.latest_ns = 0
        self.has_ended = False  # the data: what looks like a message behind it is a damaged index
        # Whether the file has chunks. What looks like a message outside of them is then damage:
        # part of one whose checksum looks like the rest, or an index, laid out alike.
        self.chunked = False
        self.unchecked: set[int] = set()  # channels that only the summary names
        self.bare: list[Found] = []
        self.bare_start = self.bare_end = 0

    def run(self) -> Index:
        """What the file holds."""
        self.read_from(len(MAGIC))
        self._close_run()
        self._note_unchecked()
        self.note_unclosed(self._is_closed)
        self.index.details += self.details()
        return self.index

    def _is_closed(self) -> bool:
        self.stream.seek(max(self.size - len(MAGIC), 0))
        return self.has_ended and self.stream.read() == MAGIC

    def _note_unchecked(self) -> None:
        topics = {self.definitions.channels[key].topic for key in self.unchecked}
        if topics and not self._is_summary_sound():
            self.index.problems.append(
                f"{self.path}: only its summary, which could not be checked, names "
                f"{', '.join(sorted(topics))}: names and types may be wrong; copy the file again"
            )

    def _is_summary_sound(self) -> bool:
        """By its own checksum; without one, nothing vouches for it."""
        self.stream.seek(max(self.size - _FOOTER_BYTES, 0))
        footer = self.stream.read(_FOOTER_BYTES)
        if len(footer) < _FOOTER_BYTES:
            return False
        start, _, crc = _FOOTER.unpack_from(footer, HEAD_BYTES)
        length = self.size - _FOOTER_BYTES - start
        if not (crc and 0 <= length <= limits().chunk_bytes):
            return False
        self.stream.seek(start)
        return bool(crc32(footer[: HEAD_BYTES + 16], crc32(self.stream.read(length))) == crc)

    def record(self, position: int) -> int:
        opcode, length = self._head(position)
        after = position + HEAD_BYTES + length
        if opcode == CHUNK:
            return self._chunk(position, after)
        if (opcode == 0 and length == 0) or (opcode > DATA_END and opcode < 0x80):
            if position == self.size - len(MAGIC):
                return self.size
            raise DamagedBlockError(f"opcode {opcode} is unknown")
        if after > self.size:
            raise DamagedBlockError("it ends within a record")
        # Damage behind a message is none of its own, unless it holds another record.
        whole = self._plausible(after) or (opcode == MESSAGE and self.following(position) >= after)
        if not whole:
            raise DamagedBlockError("no record follows where one should")
        self.has_ended |= opcode == DATA_END
        if opcode == MESSAGE:
            self._message(position, after)
        elif opcode in {HEADER, SCHEMA, CHANNEL}:
            if length > MAX_DEFINITION_BYTES:
                raise DamagedBlockError(f"a definition claims {length} bytes")
            try:
                self._definition(opcode, self.stream.read(length))
            except DamagedBlockError as error:  # what it names the summary may name once more
                self.index.problems.append(
                    f"{self.path}: record at byte {position} skipped: {error}"
                )
        return after

    def _definition(self, opcode: int, content: bytes) -> None:
        if opcode == HEADER:
            header = parsed(Header, content)
            self.index.details += [("library", header.library), ("profile", header.profile)]
            return
        known = set(self.definitions.channels)
        self.definitions.take(opcode, content)
        if self.chunked:
            self.unchecked |= self.definitions.channels.keys() - known

    def _head(self, position: int) -> tuple[int, int]:
        self.stream.seek(position)
        head = self.stream.read(HEAD_BYTES)
        if head.startswith(MAGIC[: len(head)]) and position == self.size - len(MAGIC):
            return 0, 0
        if len(head) < HEAD_BYTES:
            raise DamagedBlockError("it ends within a record")
        return record_head(head)

    def _chunk(self, position: int, after: int) -> int:
        self._close_run()
        head = parse_chunk_head(self.stream.read(128))
        consistent = position + HEAD_BYTES + head.data_at + head.data_bytes == after
        if not consistent or head.compression not in _COMPRESSIONS:
            raise DamagedBlockError("a chunk contradicts itself")
        if head.data_bytes > limits().chunk_bytes:
            raise DamagedBlockError(f"a chunk claims {head.data_bytes} bytes")
        self.chunked = True
        self.stream.seek(position)
        data = self.stream.read(after - position)
        try:
            messages = block_messages(data, self.definitions)
        except DamagedBlockError as error:
            if not self._plausible(after):
                raise
            lost_s = (head.end_ns - head.start_ns) * 1e-9
            self.index.problems.append(
                f"{self.path}: chunk at byte {position} skipped: {error}; "
                f"lost {lost_s:.2f} s of recording"
            )
            return after
        self.note_chunk(head.compression, head.data_bytes, head.size)
        self.index.add(messages, position, len(data))
        if after > self.size:
            self.index.problems.append(
                f"{self.path}: the file ends within the chunk at byte {position}, "
                f"of which {len(messages)} message(s) could be had"
            )
        return after

    def _message(self, position: int, after: int) -> None:
        if self.has_ended or self.chunked:
            raise DamagedBlockError("a message outside the chunks, or after the data")
        if after - position < HEAD_BYTES + MESSAGE_HEAD.size:
            raise DamagedBlockError("a message is shorter than its head")
        self.stream.seek(position + HEAD_BYTES)
        key, _, time, _ = MESSAGE_HEAD.unpack(self.stream.read(MESSAGE_HEAD.size))
        if not self.bare or position != self.bare_end or after - self.bare_start > _RUN_BYTES:
            self._close_run()
            self.bare_start = position
        self.bare.append((time, key, b""))
        self.latest_ns = time
        self.bare_end = after

    def _close_run(self) -> None:
        self.index.add(self.bare, self.bare_start, self.bare_end - self.bare_start)
        self.bare = []

    def _plausible(self, position: int) -> bool:
        """Whether a record, the closing magic or the end of the file stands here."""
        if position >= self.size - len(MAGIC):
            return position <= self.size
        here = self.stream.tell()
        self.stream.seek(position)
        head = self.stream.read(HEAD_BYTES)
        self.stream.seek(here)
        if len(head) < HEAD_BYTES:
            return True
        opcode, length = record_head(head)
        return (0 < opcode <= DATA_END or opcode >= 0x80) and length < 1 << 40

    def credible(self, position: int, data: bytes) -> bool:
        """Whether a chunk, a message or the end of data can begin so."""
        if len(data) < HEAD_BYTES:
            return False
        opcode, length = record_head(data)
        after = position + HEAD_BYTES + length
        if after > self.size:
            return False
        if opcode == CHUNK:
            try:
                head = parse_chunk_head(data[HEAD_BYTES:])
            except DamagedBlockError:
                return False
            return head.compression in _COMPRESSIONS and head.data_at + head.data_bytes == length
        if opcode == DATA_END:
            return length == 4 and self._plausible(after)
        if self.chunked or min(length, len(data) - HEAD_BYTES) < MESSAGE_HEAD.size:
            return False
        key, _, time, _ = MESSAGE_HEAD.unpack_from(data, HEAD_BYTES)
        near = abs(time - self.latest_ns) < _DAY_NS
        return key in self.definitions.channels and near and self._plausible(after)
