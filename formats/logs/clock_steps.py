"""A clock that was set back while a log was recorded: in the file, every topic steps back."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, field, replace
from itertools import pairwise
from pathlib import Path

import numpy as np

from formats.logs.channels import Block, Channel, Record

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

    def report(self, path: Path, problems: list[str]) -> None:
        """Adds what happened to the problems of a file."""
        problems.append(
            f"{path}: the clock was set back by {self.back_ns * 1e-9:.1f} s while recording: "
            "later messages are shifted by as much"
        )

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
        seen: dict[Channel, int] = {}
        found = []
        for time, channel, data in records:
            number = seen[channel] = seen.get(channel, -1) + 1
            after = (block.offset, number) >= self.places.get(channel, (self.first_offset + 1, 0))
            found.append((time + self.back_ns if after else time, channel, data))
        return found


@dataclass(slots=True)
class _Run:
    """A channel's log times in one block."""

    first: int
    last: int
    count: int = 1
    steps: list[tuple[int, int]] = field(default_factory=list)
    """Number of a record, and by how much it lies before the one before it."""

    def add(self, time: int) -> None:
        """One more record's."""
        if self.last - time > LEAST_STEP_NS:
            self.steps.append((self.count, self.last - time))
        self.last, self.count = time, self.count + 1


class ClockSteps:
    """Notes, block by block, where a channel's log times step back in the order of the file."""

    def __init__(self) -> None:
        self._runs: dict[Channel, dict[int, _Run]] = {}

    def add(self, offset: int, records: Iterable[Record]) -> None:
        """The records of the block at an offset, in their order there."""
        runs: dict[Channel, _Run] = {}
        for time, channel, _ in records:
            if channel in runs:
                runs[channel].add(time)
            else:
                runs[channel] = _Run(time, time)
        for channel, run in runs.items():
            self._runs.setdefault(channel, {})[offset] = run

    def found(self) -> ClockStep | None:
        """The one time at which the clock was set back; None where it was not."""
        steps = {channel: _steps(runs) for channel, runs in self._runs.items()}
        once = {channel: found[0] for channel, found in steps.items() if len(found) == 1}
        backs = [back for _, back in once.values()]
        if len(once) < max(_FEWEST, sum(map(bool, steps.values()))) or np.ptp(backs) > _ALIKE_NS:
            return None
        places = {channel: place for channel, (place, _) in once.items()}
        return ClockStep(int(np.median(backs)), places)


def step_in(blocks: Iterable[Block], read: Callable[[Block], list[Record]]) -> ClockStep | None:
    """The one time at which the clock was set back while these blocks were written, if it was.

    It shows in blocks that begin before those in front of them end, and within one alone: those
    are read.
    """
    ordered = sorted(blocks, key=lambda block: block.offset)
    near = {block for pair in pairwise(ordered) if _is_late(*pair) for block in pair}
    steps = ClockSteps()
    for block in ordered if len(ordered) == 1 else sorted(near, key=lambda block: block.offset):
        steps.add(block.offset, read(block))
    return steps.found()


def _is_late(before: Block, after: Block) -> bool:
    return before.end_ns - after.start_ns > LEAST_STEP_NS


def _steps(runs: dict[int, _Run]) -> list[tuple[Place, int]]:
    """Where a channel steps back, and by how much, its period counted in."""
    found, last, passed, count = list[tuple[Place, int]](), None, 0, 0
    for offset in sorted(runs):
        run = runs[offset]
        if last is not None and last - run.first > LEAST_STEP_NS:
            found.append(((offset, 0), last - run.first))
        found += [((offset, number), back) for number, back in run.steps]
        passed += run.last - run.first + sum(back for _, back in run.steps)
        count += run.count - 1 - len(run.steps)
        last = run.last
    period = passed // count if count else 0
    return [(place, back + period) for place, back in found]
