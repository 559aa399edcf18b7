"""What can be had of a rosbag2 database that SQLite does not read, or not to its end."""

from __future__ import annotations

import mmap
from collections.abc import Iterator
from dataclasses import dataclass, field
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
    """Time in ns, row, topic and place of each, in this order."""
    topics: dict[int, list[Value]] = field(default_factory=dict)
    lost: int = 0
    """Rows found whose bytes are not all there."""

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
    found.messages.sort(key=lambda message: message[:2])
    return found


def _rows(found: Salvage) -> Iterator[tuple[Cell, list[Value]]]:
    for cell in found.pages.cells():
        try:
            yield cell, found.pages.values(cell)
        except DamagedRowError:
            found.lost += 1
