"""A clock that was set back while a log was recorded: in the file, every topic steps back.

Log times are moved, and with them the header stamps of the same clock.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np

from formats.logs.channels import Block, Channel, Record
from mapmyworld.types import Message, RawMessage, TransformsMessage

LEAST_STEP_NS = 10**9  # less is a recorder that wrote late
_ALIKE_NS = 10**9  # by which topics may differ in how far they step back
_FEWEST = 2  # topics that must bear it out; one alone may be out of order in itself

Place = tuple[int, int]
"""Offset of a block, and number among the records of one channel in it."""


@dataclass(frozen=True, slots=True)
class ClockStep:
    """By how much a clock was set back, and what came after that."""

    back_ns: int
    places: dict[Channel, Place]
    """Each channel's first record by the new clock."""

    @property
    def first_offset(self) -> int:
        """Of the block in which the new clock begins."""
        return min(offset for offset, _ in self.places.values())

    def moved(self, block: Block) -> Block:
        """The block with times between which its records are, once mended."""
        if block.offset < self.first_offset:
            return block
        moved_ns = self.back_ns if block.offset > self.first_offset else 0
        start_ns, end_ns = block.start_ns + moved_ns, block.end_ns + self.back_ns
        return replace(block, start_ns=start_ns, end_ns=end_ns)

    def mended(self, block: Block, records: Sequence[Record]) -> list[Record]:
        """The block's records, in their order there, as if the clock had not been set."""
        found = []
        for number, (time, channel, data) in _numbered(records):
            after = (block.offset, number) >= self.places.get(channel, (self.first_offset + 1, 0))
            found.append((time + self.back_ns if after else time, channel, data))
        return found


def _numbered(records: Iterable[Record]) -> Iterable[tuple[int, Record]]:
    """Records with their number among those of the same channel."""
    seen: dict[Channel, int] = {}
    for record in records:
        number = seen[record[1]] = seen.get(record[1], -1) + 1
        yield number, record


def step_in(blocks: Iterable[Block], read: Callable[[Block], list[Record]]) -> ClockStep | None:
    """The one time at which the clock was set back while these blocks were written, if it was.

    It shows in blocks that begin before those in front of them end, and within one alone: those
    are read.
    """
    ordered = sorted(blocks, key=lambda block: block.offset)
    near = {
        block
        for before, after in pairwise(ordered)
        if before.end_ns - after.start_ns > LEAST_STEP_NS
        for block in (before, after)
    }
    found: dict[Channel, list[tuple[int, Place]]] = {}
    for block in ordered if len(ordered) == 1 else sorted(near, key=lambda block: block.offset):
        for number, (time, channel, _) in _numbered(read(block)):
            found.setdefault(channel, []).append((time, (block.offset, number)))
    steps = {channel: _steps(times) for channel, times in found.items()}
    once = {channel: late[0] for channel, late in steps.items() if len(late) == 1}
    backs = [back for _, back in once.values()]
    if len(once) < max(_FEWEST, sum(map(bool, steps.values()))) or np.ptp(backs) > _ALIKE_NS:
        return None
    return ClockStep(
        int(np.median(backs)), {channel: place for channel, (place, _) in once.items()}
    )


def _steps(times: Sequence[tuple[int, Place]]) -> list[tuple[Place, int]]:
    """Where a channel steps back, and by how much, its period counted in."""
    passed = [(later - time, place) for (time, _), (later, place) in pairwise(times)]
    onwards = [ns for ns, _ in passed if ns >= 0]
    period = int(np.median(onwards)) if onwards else 0
    return [(place, period - ns) for ns, place in passed if -ns > LEAST_STEP_NS]


def moved_stamps(raw: RawMessage, back_ns: int) -> RawMessage:
    """The message, its stamps moved by `back_ns` where they lie that much before its log time.

    So those from before the step stay, and those of another clock, which was not set.
    """
    stamp_ns = raw.stamp_ns
    if stamp_ns is None or abs(raw.log_time_ns - stamp_ns - back_ns) >= 0.5 * back_ns:
        return raw
    return replace(raw, stamp_ns=stamp_ns + back_ns, decode=lambda: _moved(raw.decode(), back_ns))


def _moved(message: Message, back_ns: int) -> Message:
    if isinstance(message, TransformsMessage):
        moved = (replace(t, stamp_ns=t.stamp_ns + back_ns) for t in message.transforms)
        return replace(message, transforms=tuple(moved))
    return replace(message, stamp_ns=message.stamp_ns + back_ns)
