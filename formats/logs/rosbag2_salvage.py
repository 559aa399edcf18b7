"""What can be had of a rosbag2 database that SQLite does not read, or not to its end."""

from __future__ import annotations

import mmap
from bisect import bisect_left
from collections.abc import Iterator
from dataclasses import dataclass, field
from itertools import islice
from operator import itemgetter
from pathlib import Path

from formats.logs.sqlite_pages import Cell, DamagedRowError, Pages, Value

_MOST_TOPICS = 10_000


@dataclass(slots=True)
class Salvage:
    """Rows by their shape: a message is (NULL, topic, time, bytes), a topic begins (NULL, name,
    type, encoding).
    """

    pages: Pages
    messages: list[tuple[int, int, int, Cell]] = field(default_factory=list)
    """Time in ns, row, topic and place of each, in the order of rows."""
    topics: dict[int, list[Value]] = field(default_factory=dict)
    lost: int = 0
    """Rows found whose bytes are not all there."""

    def rows(self, first: int, last: int) -> Iterator[tuple[int, int, int, Value]]:
        """Row, time, topic and bytes of the messages in these rows."""
        start = bisect_left(self.messages, first, key=itemgetter(1))
        for time, row, topic, cell in islice(self.messages, start, None):
            if row > last:
                return
            yield row, time, topic, self.data(cell)

    def data(self, cell: Cell) -> Value:
        """The bytes of a message."""
        return self.pages.values(cell)[3]

    @property
    def reported(self) -> str:
        """How much was found, and how much is known to be missing: rows are numbered from 1."""
        missing = max((row for _, row, _, _ in self.messages), default=0) - len(self.messages)
        return f"read page by page, {len(self.messages)} messages found, {max(missing, 0)} missed"


def salvage(path: Path) -> Salvage:
    """Every row of messages and topics in the pages of a file."""
    with path.open("rb") as stream:
        found = Salvage(Pages(mmap.mmap(stream.fileno(), 0, access=mmap.ACCESS_READ)))
    for cell, values in _rows(found):
        match values:
            case [None, int(topic), int(time), bytes()]:
                found.messages.append((time, cell.row, topic, cell))
            case [None, str(name), str(), str(), *_] if len(found.topics) < _MOST_TOPICS:
                if name.startswith("/"):  # else it is the definition of a type
                    found.topics[cell.row] = values
    found.messages.sort(key=itemgetter(1))
    return found


def _rows(found: Salvage) -> Iterator[tuple[Cell, list[Value]]]:
    for cell in found.pages.cells():
        try:
            yield cell, found.pages.values(cell)
        except DamagedRowError:
            found.lost += 1
