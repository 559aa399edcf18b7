"""A clock set back while a rosbag2 database was recorded: its rows are numbered as written."""

from __future__ import annotations

import sqlite3
from dataclasses import dataclass

from formats.logs.channels import Index
from formats.logs.clock_steps import ClockStep, ClockSteps

IS_TIMED = "typeof(timestamp) = 'integer'"
"""A row that has a time: SQLite holds any type in any column."""
_LAST_ROW = (1 << 63) - 1  # that SQLite can number


@dataclass(frozen=True, slots=True)
class RowClock:
    """A step of the clock, and the first row that was written after it."""

    step: ClockStep | None
    first_row: int

    @property
    def back_ns(self) -> int:
        """By which later rows are moved."""
        return 0 if self.step is None else self.step.back_ns

    def mended(self, time: int, row: int) -> int:
        """The time of a row, as if the clock had not been set."""
        return time + self.back_ns if row >= self.first_row else time

    def runs(self) -> tuple[tuple[int, int, int], ...]:
        """First and last row of each clock, and by how much its times are moved."""
        if self.step is None:
            return ((-_LAST_ROW, _LAST_ROW, 0),)
        return ((-_LAST_ROW, self.first_row - 1, 0), (self.first_row, _LAST_ROW, self.back_ns))


NO_STEP = RowClock(None, _LAST_ROW)
"""What most recordings have."""


def read_clock(database: sqlite3.Connection, index: Index) -> RowClock:
    """Where the clock was set back, by the order in which rows were written."""
    steps, channels = ClockSteps(), index.channels
    rows = database.execute(
        f"SELECT timestamp, topic_id FROM messages WHERE {IS_TIMED} ORDER BY id"
    )
    steps.add(0, ((time, channels[key], b"") for time, key in rows if key in channels))
    step = steps.found()
    if step is None:
        return NO_STEP
    query = (
        f"SELECT id FROM messages WHERE topic_id = ? AND {IS_TIMED} ORDER BY id LIMIT 1 OFFSET ?"
    )
    keys = {channel: key for key, channel in channels.items()}
    firsts = [
        database.execute(query, (keys[channel], number)).fetchone()[0]
        for channel, (_, number) in step.places.items()
    ]
    return RowClock(step, min(firsts))
