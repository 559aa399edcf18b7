"""Containers of serialised messages: ROS 1 bags, MCAP files and rosbag2 databases.

What a recorder noted about its own file is not believed, for it may be missing or lie, and every
command reads all of a log anyway: the index is made by reading the file through once.
"""

from __future__ import annotations

import heapq
from collections.abc import Callable, Collection, Iterable, Iterator
from contextlib import AbstractContextManager
from dataclasses import replace
from functools import partial
from operator import itemgetter
from typing import Any

from formats.bounds import LATEST_NS
from formats.logs.block_files import DamagedBlockError
from formats.logs.channels import Block, Channel, Found, Index, Record
from formats.logs.clock_steps import ClockStep, moved_stamps, step_in
from formats.logs.decoding import decoder_for
from formats.logs.files import UnpackedFile, hash_files
from mapmyworld.errors import LogError
from mapmyworld.types import LogInfo, RawMessage, TopicInfo

# Payloads of blocks that are open together. Beyond it, all others are dropped and read again: a log
# in which every chunk holds one message of a wrong, early time opens all at once.
_OPEN_BYTES = 1 << 28
_TIME = itemgetter(0)


class RecordedLog:
    """A LogSource over one file of blocks; a child knows how they are found and read."""

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
            for key in sorted(index.counts.keys() - index.channels.keys()):
                index.problems.append(
                    f"{self.path}: {index.counts[key]} message(s) of channel number {key}, which "
                    "is defined nowhere, are left out"
                )
            index.problems[:0] = self._file.problems()
            if step is not None:
                index.problems.append(
                    f"{self.path}: the clock was set back by {step.back_ns * 1e-9:.1f} s while "
                    "recording: later messages are shifted by as much"
                )
                index.blocks[:] = map(step.moved, index.blocks)
            self._index, self.clock_step = index, step
            if step is not None:
                self._mend_spans(index)
        return self._index

    def _mend_spans(self, index: Index) -> None:
        """Between which times the channels speak, had the clock not been set."""
        keys = {channel: key for key, channel in index.channels.items()}
        index.spans.clear()
        for time, channel, _ in self.records():
            first, _ = index.spans.get(keys[channel], (time, time))
            index.spans[keys[channel]] = first, time

    def info(self) -> LogInfo:
        index = self.index()
        return LogInfo(
            (str(self.path),),
            self.name,
            self.path.stat().st_size,
            merged_topics(map(self._topic, index.channels)),
            tuple(index.details),
            tuple(dict.fromkeys(index.problems)),
        )

    def _topic(self, key: int) -> TopicInfo:
        index = self.index()
        channel, count = index.channels[key], index.counts.get(key, 0)
        kind, span = decoder_for(channel).kind, map(_in_range, index.spans.get(key, ()))
        return TopicInfo(channel.topic, channel.type_name, kind, channel.encoding, count, *span)

    def content_hash(self) -> str:
        return hash_files([self.path])

    def let_go(self) -> None:
        """Nothing: the index is small, and messages stay in the file."""

    def messages(self, topics: Collection[str] | None = None) -> Iterator[RawMessage]:
        for record, mended in self.mended_records(topics):
            yield _message(record) if mended is None else mended

    def mended_records(
        self, topics: Collection[str] | None = None
    ) -> Iterator[tuple[Record, RawMessage | None]]:
        """Messages as recorded; beside those whose stamps a set clock spoilt, as they should be."""
        self.index()  # with which the step is known
        step = self.clock_step
        for record in self.records(topics):
            raw = None if step is None else _message(record)
            moved = None if raw is None or step is None else moved_stamps(raw, step.back_ns)
            yield record, None if moved is raw else moved

    def records(self, topics: Collection[str] | None = None) -> Iterator[Record]:
        """Messages as recorded, undecoded, in log-time order, block by block."""
        index = self.index()
        wanted = {
            key: channel
            for key, channel in index.channels.items()
            if topics is None or channel.topic in topics
        }
        blocks = [block for block in index.blocks if not block.channels.isdisjoint(wanted)]
        with self._opened() as source:
            for time, channel, data in in_time_order(blocks, partial(self._mended, source, wanted)):
                yield _in_range(time), channel, data

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


def _in_range(time: int) -> int:
    return min(max(time, 0), LATEST_NS)


def _message(record: Record) -> RawMessage:
    time, channel, data = record
    return decoder_for(channel).message(data, time)


def merged_topics(topics: Iterable[TopicInfo]) -> tuple[TopicInfo, ...]:
    """One entry a topic and type, by name; counts added up."""
    found: dict[tuple[str, str], TopicInfo] = {}
    for topic in topics:
        key = (topic.topic, topic.type_name)
        found[key] = _added(found[key], topic) if key in found else topic
    return tuple(found[key] for key in sorted(found))


def _added(a: TopicInfo, b: TopicInfo) -> TopicInfo:
    firsts = [t.first_ns for t in (a, b) if t.first_ns is not None]
    lasts = [t.last_ns for t in (a, b) if t.last_ns is not None]
    first, last = min(firsts, default=None), max(lasts, default=None)
    return replace(a, count=a.count + b.count, first_ns=first, last_ns=last)


def in_time_order(
    blocks: Collection[Block],
    read: Callable[[Block], list[Record]],
    open_bytes: int = _OPEN_BYTES,
) -> Iterator[Record]:
    """Records by log time; equal times in the order of the file.

    A block is read when the time has come at which it starts, and dropped when it is used up, so
    that only overlapping blocks are in memory together, of those at most `open_bytes` or one.
    """
    block_at = {block.offset: block for block in blocks}
    opened: dict[int, tuple[list[Record], int]] = {}  # with the bytes that they take
    # Time and block of the next record, and its number there; -1 before the first is known.
    heap = [(block.start_ns, block.offset, -1) for block in blocks]
    heapq.heapify(heap)
    while heap:
        _, offset, number = heapq.heappop(heap)
        if offset not in opened:
            records = sorted(read(block_at[offset]), key=_TIME)
            size = sum(len(data) for _, _, data in records)
            if size + sum(taken for _, taken in opened.values()) > open_bytes:
                opened.clear()
            opened[offset] = records, size
        records, _ = opened[offset]
        if number >= 0:
            yield records[number]
        if number + 1 < len(records):
            heapq.heappush(heap, (records[number + 1][0], offset, number + 1))
        else:
            opened.pop(offset)
