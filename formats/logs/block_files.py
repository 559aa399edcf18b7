"""Files that are read block by block: ROS 1 bags, MCAP files and rosbag2 databases.

What a recorder noted about its own file is not believed, for it may be missing or lie, and every
command reads all of a log anyway: the index is made by reading the file through once.
"""

from __future__ import annotations

import os
import re
from collections.abc import Callable, Collection, Iterator
from contextlib import AbstractContextManager
from functools import partial
from pathlib import Path
from typing import Any, BinaryIO, TypeVar

from formats.logs.channels import Block, Channel, Found, Index, Record
from formats.logs.clock_steps import ClockStep, step_in
from formats.logs.files import UnpackedFile
from formats.logs.time_order import in_time_order
from mapmyworld.errors import LogError

Definitions = TypeVar("Definitions")
_WINDOW_BYTES = 1 << 20
HEAD_BYTES = 128
"""Of a record, by which its beginning is recognised."""


class DamagedBlockError(Exception):
    """A block that cannot be read; the message says why."""


class BlockFile:
    """One file of blocks; a child knows how they are found and read."""

    def __init__(self, file: UnpackedFile, name: str) -> None:
        self._file, self.path = file, file.path
        self.name = name
        self._index: Index | None = None
        self.clock_step: ClockStep | None = None
        """Where the clock was set back; known with the index."""

    def _opened(self) -> AbstractContextManager[Any]:
        """What the blocks are read from."""
        return self._file.open()

    def _scan(self, source: Any) -> Index:
        """All of it; what is bad is skipped and reported."""
        raise NotImplementedError

    def _messages(self, source: Any, block: Block) -> list[Found]:
        """A block's messages in file order; DamagedBlockError where it is not as it was."""
        raise NotImplementedError

    def index(self) -> Index:
        """Blocks and channels; made by looking through all of the file."""
        if self._index is None:
            with self._opened() as source:
                index = self._scan(source)
                step = step_in(index.blocks, partial(self._records, source, index.channels))
            _note_nameless(index, self.path)
            index.problems[:0] = self._file.problems()
            if step is not None:
                step.report(self.path, index.problems)
                index.blocks[:] = map(step.moved, index.blocks)
            self._index, self.clock_step = index, step
        return self._index

    def records(self, topics: Collection[str] | None = None) -> Iterator[Record]:
        """Records in log-time order, block by block."""
        index = self.index()
        wanted = {
            key: channel
            for key, channel in index.channels.items()
            if topics is None or channel.topic in topics
        }
        blocks = [block for block in index.blocks if not block.channels.isdisjoint(wanted)]
        with self._opened() as source:
            yield from in_time_order(blocks, partial(self._mended, source, wanted))

    def _mended(self, source: Any, wanted: dict[int, Channel], block: Block) -> list[Record]:
        records = self._records(source, wanted, block)
        return records if self.clock_step is None else self.clock_step.mended(block, records)

    def _records(self, source: Any, wanted: dict[int, Channel], block: Block) -> list[Record]:
        """A block's records on these channels."""
        try:
            found = self._messages(source, block)
        except DamagedBlockError as error:
            raise LogError(
                f"{self.path}: was changed or removed while it was read ({error}): give the same "
                "command again when it is complete"
            ) from error
        return [(time, wanted[key], data) for time, key, data in found if key in wanted]


def _note_nameless(index: Index, path: Path) -> None:
    for key in sorted(index.counts.keys() - index.channels.keys()):
        index.problems.append(
            f"{path}: {index.counts[key]} message(s) of channel number {key}, which is defined "
            "nowhere, are left out"
        )


Taking = Callable[[bytes, int, Definitions, list[Found]], int]
"""Takes in the record at a position in bytes, and gives the position after it."""


def messages_of(
    data: bytes, take: Taking[Definitions], known: Definitions, *, to_the_end: bool = True
) -> list[Found]:
    """Those of all records, in file order; what they define goes into `known`.

    Where `to_the_end` is False, damage ends the list instead of raising DamagedBlockError.
    """
    messages = list[Found]()
    position = 0
    try:
        while position < len(data):
            position = take(data, position, known, messages)
    except DamagedBlockError:
        if to_the_end:
            raise
    return messages


class RecordScan:
    """One reading of a file of records, from the first to the last; bad ones are skipped."""

    beginning: re.Pattern[bytes]
    """Of a record that reading goes on with after a bad one."""

    def __init__(self, stream: BinaryIO, path: Path) -> None:
        self.stream, self.path, self.index = stream, path, Index()
        self.size = os.fstat(stream.fileno()).st_size
        self._compressions: set[str] = set()
        self._chunks = self._stored = self._plain = 0

    def record(self, position: int) -> int:
        """Takes in the record at `position` and gives the position after it.

        Raises DamagedBlockError where there is none.
        """
        raise NotImplementedError

    def credible(self, position: int, data: bytes) -> bool:
        """Whether a record that reading can go on with begins so."""
        raise NotImplementedError

    def read_from(self, position: int) -> None:
        """All records from this position on."""
        while position < self.size:
            try:
                position = self.record(position)
            except DamagedBlockError as error:
                following = self.following(position)
                self.index.problems.append(
                    f"{self.path}: damaged or cut at byte {position} ({error}): "
                    f"{following - position} bytes skipped"
                )
                position = following

    def following(self, position: int) -> int:
        """Where the next credible record behind `position` begins, or the file's size."""
        position += 1
        while position < self.size:
            self.stream.seek(position)
            window = self.stream.read(_WINDOW_BYTES + HEAD_BYTES)
            for found in self.beginning.finditer(window):
                at = found.start()
                head = window[at : at + HEAD_BYTES]
                if at < _WINDOW_BYTES and self.credible(position + at, head):
                    return position + at
            position += _WINDOW_BYTES
        return self.size

    def note_chunk(self, compression: str, stored: int, plain: int) -> None:
        """One more chunk, of so many bytes in the file, and unpacked."""
        self._compressions.add(compression or "none")
        self._chunks, self._stored = self._chunks + 1, self._stored + stored
        self._plain += plain

    def details(self) -> list[tuple[str, str]]:
        """How the file is laid out."""
        is_packed = self._stored < self._plain
        saved = f" ({1 - self._stored / self._plain:.1%} saved)" if is_packed else ""
        names = ", ".join(sorted(self._compressions))
        chunks = [("compression", names + saved)] if names else []
        return [*chunks, ("chunks", str(self._chunks))]

    def note_unclosed(self, is_closed: Callable[[], bool]) -> None:
        """Reports a file that ends too early, where nothing else shows that it does."""
        if not self.index.problems and not is_closed():
            self.index.problems.append(
                f"{self.path}: the recording was not closed, or its end is missing"
            )
