"""A clock that was set back while a log was recorded: in the file, every topic steps back."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from formats.logs.channels import Channel, Record

_LEAST_NS = 10**9  # less is a recorder that wrote late
_ALIKE_NS = 10**9  # by which topics may differ in how far they step back: their own periods
_FEWEST = 2  # topics that must bear it out; one alone may be out of order in itself


class ClockSteps:
    """Notes, block by block, where a channel's log times step back in the order of the file."""

    def __init__(self) -> None:
        self._spans: dict[int, dict[Channel, tuple[int, int, int]]] = {}

    def add(self, offset: int, records: Sequence[Record]) -> None:
        """The records of the block at an offset, in their order there."""
        spans: dict[Channel, tuple[int, int, int]] = {}
        for time, channel, _ in records:
            first, last, step = spans.get(channel, (time, time, 0))
            spans[channel] = first, time, max(step, last - time)
        self._spans[offset] = spans

    def set_back_s(self) -> float:
        """Seconds by which the clock was set back; 0 where it was not."""
        last: dict[Channel, int] = {}
        steps: dict[Channel, list[int]] = {}
        for offset in sorted(self._spans):
            for channel, (first, end, inside) in self._spans[offset].items():
                back = max(last.get(channel, first) - first, inside)
                last[channel] = end
                if back > _LEAST_NS:
                    steps.setdefault(channel, []).append(back)
        backs = [found[0] for found in steps.values() if len(found) == 1]
        if len(backs) < max(_FEWEST, len(steps)) or np.ptp(backs) > _ALIKE_NS:
            return 0.0
        return float(np.median(backs)) * 1e-9
