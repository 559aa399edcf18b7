"""Records of many blocks in time order, with as few blocks in memory as their times allow."""

from __future__ import annotations

import heapq
from collections import deque
from collections.abc import Callable, Collection, Iterator
from operator import itemgetter

from formats.logs.channels import Block, Record

# Payloads of blocks that are open together. Beyond it, those needed last are dropped and read
# again: a log in which every chunk holds one message of a wrong, early time opens all at once.
_OPEN_BYTES = 1 << 28
_TIME = itemgetter(0)


class _Open:
    """A block that is being handed out; `records` is None while it is dropped."""

    __slots__ = ("block", "records", "size")

    def __init__(self, block: Block, records: list[Record]) -> None:
        self.block = block
        self.records: list[Record] | None = records
        self.size = sum(len(record[2]) for record in records)


_Entry = tuple[int, int, int, _Open]
"""Time of the next record, offset of the block, number of that record, the block."""


def in_time_order(
    blocks: Collection[Block],
    read: Callable[[Block], list[Record]],
    open_bytes: int = _OPEN_BYTES,
) -> Iterator[Record]:
    """Records by log time; equal times in the order of the file.

    A block is handed out when the time has come at which it starts, and dropped when it is used up,
    so that only overlapping blocks are in memory together, of those at most `open_bytes` and one.
    """
    pending = deque(sorted(blocks, key=lambda block: (block.start_ns, block.offset)))
    heap: list[_Entry] = []
    while pending or heap:
        while pending and (not heap or pending[0].start_ns <= heap[0][0]):
            block = pending.popleft()
            records = sorted(read(block), key=_TIME)
            if records:
                heapq.heappush(heap, (records[0][0], block.offset, 0, _Open(block, records)))
                _drop_the_last(heap, open_bytes)
        if not heap:
            continue
        _, offset, number, opened = heapq.heappop(heap)
        if opened.records is None:
            opened.records = sorted(read(opened.block), key=_TIME)
            _drop_the_last(heap, open_bytes - opened.size)
        yield opened.records[number]
        if number + 1 < len(opened.records):
            after = opened.records[number + 1][0]
            heapq.heappush(heap, (after, offset, number + 1, opened))


def _drop_the_last(heap: list[_Entry], open_bytes: int) -> None:
    """Where open blocks exceed the limit, keeps those needed soonest, up to half of it."""
    if len(heap) < 2 or sum(e[3].size for e in heap if e[3].records is not None) <= open_bytes:
        return
    kept = 0
    for entry in sorted(heap, key=lambda entry: entry[:2]):
        kept += entry[3].size
        if kept > open_bytes // 2:
            entry[3].records = None
