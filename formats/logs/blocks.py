"""Records of many blocks in time order, with as few blocks open as their times allow."""

from __future__ import annotations

import heapq
from collections import deque
from collections.abc import Callable, Collection, Iterator
from operator import itemgetter
from pathlib import Path
from typing import BinaryIO

from formats.logs.channels import Block, Channel, Index, Record
from formats.logs.files import open_binary

_TIME = itemgetter(0)


class DamagedBlockError(Exception):
    """A block that cannot be read; the message says why."""


def in_time_order(
    blocks: Collection[Block], read: Callable[[Block], list[Record]]
) -> Iterator[Record]:
    """Records by log time; equal times in the order of the file.

    A block is read when the time has come at which it starts, and dropped when it is used up, so
    that only overlapping blocks are in memory together.
    """
    pending = deque(sorted(blocks, key=lambda block: (block.start_ns, block.offset)))
    # Open blocks: time of the next record, offset of the block, number of that record, records.
    heap: list[tuple[int, int, int, list[Record]]] = []
    while pending or heap:
        while pending and (not heap or pending[0].start_ns <= heap[0][0]):
            block = pending.popleft()
            records = sorted_records(read(block))
            if records:
                heapq.heappush(heap, (records[0][0], block.offset, 0, records))
        if not heap:
            continue
        _, offset, first, records = heapq.heappop(heap)
        last = _run_length(first, offset, records, heap, pending)
        yield from records[first:last] if last - first < len(records) else records
        if last < len(records):
            heapq.heappush(heap, (records[last][0], offset, last, records))


def _run_length(
    first: int,
    offset: int,
    records: list[Record],
    heap: list[tuple[int, int, int, list[Record]]],
    pending: deque[Block],
) -> int:
    """The number of the first record that must wait for another block; one at least goes now."""
    others = heap[0][:2] if heap else None
    start = pending[0].start_ns if pending else None
    last_ns = records[-1][0]
    if (start is None or last_ns < start) and (others is None or (last_ns, offset) < others):
        return len(records)
    last = first + 1
    while last < len(records):
        time = records[last][0]
        if (start is not None and time >= start) or (others and (time, offset) > others):
            break
        last += 1
    return last


def sorted_records(records: list[Record]) -> list[Record]:
    """Records by time, stably; the same list where it is in order already."""
    previous = -1
    for record in records:
        if record[0] < previous:
            return sorted(records, key=_TIME)
        previous = record[0]
    return records


IndexReader = Callable[[BinaryIO, Path], Index]
BlockReader = Callable[[BinaryIO, Block, dict[int, Channel], bool], list[Record]]
"""Reads a block's records on these channels; the last argument says whether to check sums."""


class BlockFile:
    """A Container over one file of blocks: a ROS 1 bag or an MCAP file."""

    def __init__(
        self, path: Path, name: str, read_index: IndexReader, read_block: BlockReader
    ) -> None:
        self.path = path
        self.name = name
        self._read_index, self._read_block = read_index, read_block
        self._index: Index | None = None
        self._losses: list[str] = []
        self._checked: set[int] = set()

    def index(self) -> Index:
        if self._index is None:
            with open_binary(self.path) as stream:
                self._index = self._read_index(stream, self.path)
        return self._index

    def files(self) -> tuple[Path, ...]:
        return (self.path,)

    def losses(self) -> tuple[str, ...]:
        return (*self.index().problems, *self._losses)

    def records(self, topics: Collection[str] | None = None) -> Iterator[Record]:
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
        with open_binary(self.path) as stream:

            def read(block: Block) -> list[Record]:
                check = block.offset not in self._checked  # once is enough for one log
                try:
                    records = self._read_block(stream, block, wanted, check)
                    self._checked.add(block.offset)
                    return records
                except DamagedBlockError as error:
                    losses.append(
                        f"{self.path}: chunk at byte {block.offset} skipped: {error}; "
                        f"lost {(block.end_ns - block.start_ns) * 1e-9:.2f} s of recording"
                    )
                    return []

            yield from in_time_order(blocks, read)
