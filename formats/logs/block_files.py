"""Files that are read block by block: ROS 1 bags and MCAP files."""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Callable, Collection, Iterator
from functools import partial
from pathlib import Path
from typing import BinaryIO

from formats.logs.channels import Block, Channel, Index, Record
from formats.logs.clock_steps import ClockStep, step_in
from formats.logs.files import UnpackedFile
from formats.logs.time_order import in_time_order

_WINDOW_BYTES = 1 << 20


class DamagedBlockError(Exception):
    """A block that cannot be read; the message says why."""


IndexReader = Callable[[BinaryIO, Path], Index]
BlockReader = Callable[[BinaryIO, Block, dict[int, Channel], bool], list[Record]]
"""Reads a block's records on these channels; the last argument says whether to check sums."""


def borne_out(
    index: Index, is_chunk: Callable[[int], bool], scan: Callable[[], Index], path: Path
) -> Index:
    """The index where a chunk of its own stands at each of its places; else what `scan` finds.

    Where that finds no chunk elsewhere, those that the index names were hit: then it stays.
    """
    named = {block.offset for block in index.blocks}
    if len(named) == len(index.blocks) and all(map(is_chunk, sorted(named))):
        return index
    scanned = scan()
    if all(block.offset in named for block in scanned.blocks if not block.bare):
        return index
    scanned.problems.insert(
        0, f"{path}: the index points to places without a chunk: chunks were read one by one"
    )
    return scanned


def next_place(
    stream: BinaryIO,
    position: int,
    size: int,
    pattern: re.Pattern[bytes],
    fits: Callable[[int, bytes], bool],
) -> int:
    """Where the next record can be, at or after `position`; the file's size where none can.

    Its beginning is found by `pattern`, and `fits` judges its place and its first 128 bytes.
    """
    while position < size:
        stream.seek(position)
        window = stream.read(_WINDOW_BYTES + 128)
        for found in pattern.finditer(window):
            at = found.start()
            if at < _WINDOW_BYTES and fits(position + at, window[at : at + 128]):
                return position + at
        position += _WINDOW_BYTES
    return size


def _note_nameless(index: Index, path: Path) -> None:
    for key in sorted(index.counts.keys() - index.channels.keys()):
        index.problems.append(
            f"{path}: {index.counts[key]} message(s) of channel number {key}, which is defined "
            "nowhere, are left out"
        )


class _Found:
    """What blocks held in fact, beside what the index reports about them."""

    def __init__(self) -> None:
        self._counts: dict[int, Counter[Channel]] = {}
        self._early: dict[int, int] = {}

    def add(self, block: Block, records: list[Record]) -> None:
        """A block as it was read, the first time or again."""
        self._counts[block.offset] = Counter(channel for _, channel, _ in records)
        earliest_ns = min((time for time, _, _ in records), default=block.start_ns)
        self._early[block.offset] = block.start_ns - earliest_ns

    def contradictions(self, name: object, index: Index, wanted: dict[int, Channel]) -> list[str]:
        """Where an index lies: what stands elsewhere than it says is not read, or in no order."""
        losses = list[str]()
        early = max(self._early.values(), default=0)
        if early > 0:
            losses.append(
                f"{name}: chunks begin up to {early * 1e-9:.3f} s before the times in "
                "its index: messages may be out of order"
            )
        if len(self._counts) < len(index.blocks):
            met = sum(self._counts.values(), Counter[Channel]())
            for key, channel in wanted.items():
                missing = index.counts.get(key, 0) - met[channel]
                if missing > 0:
                    losses.append(
                        f"{name}: {missing} messages of {channel.topic} are not where its "
                        "index says"
                    )
        return losses


class BlockFile:
    """One file of blocks: a ROS 1 bag or an MCAP file."""

    def __init__(
        self, file: UnpackedFile, name: str, read_index: IndexReader, read_block: BlockReader
    ) -> None:
        self._file, self.path = file, file.path
        self.name = name
        self._read_index, self._read_block = read_index, read_block
        self._index: Index | None = None
        self._losses: list[str] = []
        self._checked: set[int] = set()
        self.clock_step: ClockStep | None = None
        """Where the clock was set back; known with the index."""

    def index(self) -> Index:
        """Blocks and channels; read from the file's summary, or by looking through all of it."""
        if self._index is None:
            with self._file.open() as stream:
                self._index = index = self._read_index(stream, self.path)
                self.clock_step = step_in(index.blocks, partial(self._sound, stream, index))
            _note_nameless(self._index, self.path)
            self._index.problems[:0] = self._file.problems()
            if self.clock_step is not None:
                self.clock_step.report(self.path, index.problems)
                index.blocks[:] = map(self.clock_step.moved, index.blocks)
        return self._index

    def _sound(self, stream: BinaryIO, index: Index, block: Block) -> list[Record]:
        """A block's records; none of a damaged one, which is reported when it is read."""
        try:
            return self._read_block(stream, block, index.channels, True)
        except DamagedBlockError:
            return []

    def files(self) -> tuple[Path, ...]:
        """The file itself."""
        return (self.path,)

    def losses(self) -> tuple[str, ...]:
        """Of the index, and of what was read since."""
        return (*self.index().problems, *self._losses)

    def records(self, topics: Collection[str] | None = None) -> Iterator[Record]:
        """Records in log-time order, block by block."""
        index = self.index()
        wanted = {
            key: channel
            for key, channel in index.channels.items()
            if topics is None or channel.topic in topics
        }
        blocks = [
            b for b in index.blocks if b.channels is None or not b.channels.isdisjoint(wanted)
        ]
        losses: list[str] = []
        self._losses = losses
        found = _Found()
        with self._file.open() as stream:

            def read(block: Block) -> list[Record]:
                check = block.offset not in self._checked  # once is enough for one log
                try:
                    records = self._read_block(stream, block, wanted, check)
                    self._checked.add(block.offset)
                    if self.clock_step is not None:
                        records = self.clock_step.mended(block, records)
                    found.add(block, records)
                    return records
                except DamagedBlockError as error:
                    losses.append(
                        f"{self.path}: chunk at byte {block.offset} skipped: {error}; "
                        f"lost {(block.end_ns - block.start_ns) * 1e-9:.2f} s of recording"
                    )
                    return []

            yield from in_time_order(blocks, read)
        if not losses:
            losses += found.contradictions(self.path, index, wanted)
