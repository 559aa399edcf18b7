"""Rows of a damaged SQLite file, from every page that can be read, whatever became of the others.

SQLite follows pointers from page to page and gives up at the first that leads nowhere. Here each
page is read for itself. Layout: "Database File Format", sqlite.org/fileformat2.html, 1.3 to 1.6.
"""

from __future__ import annotations

import mmap
from bisect import bisect_left
from collections.abc import Iterator
from dataclasses import dataclass, field
from itertools import islice
from operator import itemgetter
from pathlib import Path

from formats.limits import limits

Value = int | float | str | bytes | None
_TABLE_LEAF = 13
_FILE_HEAD = 100  # bytes before the first page's own head
_LEAF_HEAD = 8
_MAPPED_BYTES = 1 << 25
_INTEGERS = {1: 1, 2: 2, 3: 3, 4: 4, 5: 6, 6: 8}  # serial type -> bytes


@dataclass(frozen=True, slots=True)
class Cell:
    """A row's place in the file: where its payload begins, how long it is and how much is here."""

    row: int
    at: int
    length: int
    here: int


class Pages:
    """The pages of a file that begins as a database does."""

    def __init__(self, data: bytes | mmap.mmap) -> None:
        self._data = data
        size = int.from_bytes(data[16:18], "big")
        self.size = 65536 if size == 1 else max(size, 512)
        self._usable = self.size - data[20] if len(data) > 20 else self.size
        self._read_bytes = 0  # since pages were last given back

    def cells(self) -> Iterator[Cell]:
        """Those of all leaves of tables that are there in full, by their place."""
        for start in range(0, len(self._data) - self.size + 1, self.size):
            self._give_back(self.size)
            head = start + (_FILE_HEAD if start == 0 else 0)
            if self._data[head] == _TABLE_LEAF:
                yield from self._page_cells(start, head)

    def _give_back(self, size: int) -> None:
        """After so many bytes more: a mapped file counts as memory as far as it was read."""
        self._read_bytes += size
        if self._read_bytes >= _MAPPED_BYTES and isinstance(self._data, mmap.mmap):
            self._data.madvise(mmap.MADV_DONTNEED)
            self._read_bytes = 0

    def _page_cells(self, start: int, head: int) -> Iterator[Cell]:
        count = int.from_bytes(self._data[head + 3 : head + 5], "big")
        last = start + self.size
        for k in range(min(count, (self.size - _LEAF_HEAD) // 2)):
            pointer = head + _LEAF_HEAD + 2 * k
            at = start + int.from_bytes(self._data[pointer : pointer + 2], "big")
            if not head + _LEAF_HEAD <= at < last - 2:
                continue
            length, at = _varint(self._data, at)
            row, at = _varint(self._data, at)
            here = self._local(length)
            if 0 < length <= limits().chunk_bytes and at + here <= last:
                yield Cell(row, at, length, here)

    def _local(self, length: int) -> int:
        """How much of a payload stands in the leaf itself."""
        most = self._usable - 35
        if length <= most:
            return length
        least = (self._usable - 12) * 32 // 255 - 23
        wanted = least + (length - least) % (self._usable - 4)
        return wanted if wanted <= most else least

    def values(self, cell: Cell) -> list[Value]:
        """The columns of a row; ValueError where it is not whole."""
        payload = self._payload(cell)
        head, at = _varint(payload, 0)
        found, place = list[Value](), head
        while at < min(head, len(payload)):
            kind, at = _varint(payload, at)
            size = _width(kind)
            if place + size > len(payload):
                raise ValueError("part of a row is not there")
            found.append(_value(kind, payload[place : place + size]))
            place += size
        return found

    def _payload(self, cell: Cell) -> bytes:
        self._give_back(cell.length)
        parts, left = [bytes(self._data[cell.at : cell.at + cell.here])], cell.length - cell.here
        at = cell.at + cell.here
        while left:
            page = int.from_bytes(self._data[at : at + 4], "big")
            at = (page - 1) * self.size
            size = min(left, self._usable - 4)
            if page < 2 or at + 4 + size > len(self._data):
                raise ValueError("part of a row is not there")
            parts.append(bytes(self._data[at + 4 : at + 4 + size]))
            left -= size
        return b"".join(parts)


def _varint(data: bytes | mmap.mmap, at: int) -> tuple[int, int]:
    """A number of one to nine bytes, and the place behind it."""
    value = 0
    for k in range(min(9, len(data) - at)):
        byte = data[at + k]
        if k == 8:
            return (value << 8 | byte) & (1 << 64) - 1, at + 9
        value = value << 7 | byte & 0x7F
        if byte < 0x80:
            return value, at + k + 1
    return 0, len(data)


def _width(kind: int) -> int:
    """Bytes of a value of this serial type."""
    if kind >= 12:
        return (kind - 12) // 2
    return 8 if kind == 7 else _INTEGERS.get(kind, 0)


def _value(kind: int, data: bytes) -> Value:
    if kind >= 12:
        return data if kind % 2 == 0 else data.decode("utf-8", "replace")
    if kind in _INTEGERS:
        return int.from_bytes(data, "big", signed=True)
    return {8: 0, 9: 1, 7: 0.0}.get(kind)  # no column of a recording is a floating number


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
    for cell in found.pages.cells():
        try:
            values = found.pages.values(cell)
        except ValueError:
            continue
        match values:
            case [None, int(topic), int(time), bytes()]:
                found.messages.append((time, cell.row, topic, cell))
            case [None, str(name), str(), str(), *_] if len(found.topics) < _MOST_TOPICS:
                if name.startswith("/"):  # else it is the definition of a type
                    found.topics[cell.row] = values
    found.messages.sort(key=itemgetter(1))
    return found
