"""The index of an MCAP file that has none, made by reading it through and skipping what is bad."""

from __future__ import annotations

import re
from pathlib import Path
from typing import BinaryIO

from formats.limits import limits
from formats.logs.block_files import DamagedBlockError, next_place
from formats.logs.channels import Found, Index
from formats.logs.compression import MAX_DEFINITION_BYTES
from formats.logs.mcap_chunks import chunk_beginning, chunk_data
from formats.logs.mcap_records import (
    CHANNEL,
    CHUNK,
    DATA_END,
    HEAD_BYTES,
    MAGIC,
    MESSAGE,
    MESSAGE_HEAD,
    SCHEMA,
    Definitions,
    chunk_messages,
    parse_chunk_head,
    record_head,
)

_RUN_BYTES = 1 << 20  # bare messages gathered into one block
_DAY_NS = 86_400_000_000_000
_COMPRESSIONS = {"", "none", "lz4", "zstd"}
# A chunk, message or end-of-data record whose length is below 2^40.
_CANDIDATE = re.compile(rb"[\x05\x06\x0f].{5}\x00\x00\x00", re.DOTALL)


def scan(stream: BinaryIO, path: Path, size: int) -> Index:
    """Reads every record; bad stretches are skipped and reported."""
    return _Scan(stream, path, size).run()


class _Scan:
    """The state of one reading: where we are, what is defined, the block being gathered."""

    def __init__(self, stream: BinaryIO, path: Path, size: int) -> None:
        self.stream, self.path, self.size = stream, path, size
        self.index = Index(details=[("index", "none, rebuilt")])
        self.definitions = Definitions()
        self.latest_ns = 0
        self.has_ended = False  # the data: what looks like a message behind it is a damaged index
        # Whether the file has chunks. What looks like a message outside of them is then damage:
        # part of one whose checksum looks like the rest, or an index, laid out alike.
        self.chunked = False
        self.unchecked: set[int] = set()  # channels that only the summary names
        self.bare: list[Found] = []
        self.bare_start = self.bare_end = 0

    def run(self) -> Index:
        position = len(MAGIC)
        while position < self.size:
            try:
                position = self._record(position)
            except DamagedBlockError as error:
                following = self._following(position)
                self.index.problems.append(
                    f"{self.path}: damaged or cut at byte {position} ({error}): "
                    f"{following - position} bytes skipped"
                )
                position = following
        self._close_run()
        self._note_unchecked()
        self.index.channels = self.definitions.channels
        self.index.details.append(("blocks", str(len(self.index.blocks))))
        return self.index

    def _note_unchecked(self) -> None:
        topics = {self.definitions.channels[key].topic for key in self.unchecked}
        if topics:
            self.index.problems.append(
                f"{self.path}: only its summary, which could not be checked, names "
                f"{', '.join(sorted(topics))}: names and types may be wrong; copy the file again"
            )

    def _record(self, position: int) -> int:
        """Takes in the record at `position` and gives the position after it."""
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
        whole = self._plausible(after) or (opcode == MESSAGE and self._following(position) >= after)
        if not whole:
            raise DamagedBlockError("no record follows where one should")
        self.has_ended |= opcode == DATA_END
        if opcode == MESSAGE:
            self._message(position, after)
        elif opcode in {SCHEMA, CHANNEL}:
            if length > MAX_DEFINITION_BYTES:
                raise DamagedBlockError(f"a definition claims {length} bytes")
            self._definition(opcode, self.stream.read(length))
        return after

    def _definition(self, opcode: int, content: bytes) -> None:
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
        content_start = self.stream.read(128)
        head = parse_chunk_head(content_start)
        consistent = position + HEAD_BYTES + head.data_at + head.data_bytes == after
        if not consistent or head.compression not in _COMPRESSIONS:
            raise DamagedBlockError("a chunk contradicts itself")
        self.chunked = True
        self.stream.seek(position)
        if after > self.size:
            self._cut_chunk(position)
            return self.size
        try:
            messages = chunk_messages(chunk_data(self.stream), self.definitions)
        except DamagedBlockError as error:
            if not self._plausible(after):
                raise
            lost_s = (head.end_ns - head.start_ns) * 1e-9
            self.index.problems.append(
                f"{self.path}: chunk at byte {position} skipped: {error}; "
                f"lost {lost_s:.2f} s of recording"
            )
            return after
        self.index.add(messages, position, 0)
        return after

    def _cut_chunk(self, position: int) -> None:
        """Keeps the messages of the last chunk that a cut file still has."""
        content = self.stream.read(min(self.size - position, limits().chunk_bytes))[HEAD_BYTES:]
        plain = chunk_beginning(content)
        messages = chunk_messages(plain, self.definitions, to_the_end=False)
        self.index.add(messages, position, len(content))
        self.index.problems.append(
            f"{self.path}: the file ends within the chunk at byte {position}, "
            f"of which {len(messages)} message(s) could be had"
        )

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
        if self.bare:
            self.index.add(self.bare, self.bare_start, self.bare_end - self.bare_start, bare=True)
            self.bare = []

    def _plausible(self, position: int) -> bool:
        """Whether a record, the closing magic or the end of the file stands here."""
        if position >= self.size - len(MAGIC):
            return position in {self.size, self.size - len(MAGIC)} or position < self.size
        here = self.stream.tell()
        self.stream.seek(position)
        head = self.stream.read(HEAD_BYTES)
        self.stream.seek(here)
        if len(head) < HEAD_BYTES:
            return True
        opcode, length = record_head(head)
        return (0 < opcode <= DATA_END or opcode >= 0x80) and length < 1 << 40

    def _following(self, position: int) -> int:
        """Where the next chunk, message or end of data can be, or the file's size."""
        return next_place(self.stream, position + 1, self.size, _CANDIDATE, self._credible)

    def _credible(self, position: int, data: bytes) -> bool:
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
