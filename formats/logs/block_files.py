"""Files of records, bags and MCAP files, read through from the first record to the last."""

from __future__ import annotations

import os
import re
from collections.abc import Callable
from pathlib import Path
from typing import BinaryIO, TypeVar

from formats.logs.channels import Found, Index

Definitions = TypeVar("Definitions")
_WINDOW_BYTES = 1 << 20
HEAD_BYTES = 128
"""Of a record, by which its beginning is recognised."""


class DamagedBlockError(Exception):
    """A block that cannot be read; the message says why."""


Taking = Callable[[bytes, int, Definitions, list[Found]], int]
"""Takes in the record at a position in bytes, and gives the position after it."""


def messages_of(
    data: bytes, take: Taking[Definitions], known: Definitions, *, to_the_end: bool = True
) -> list[Found]:
    """Those of all records, in file order; what they define goes into `known`.

    Where `to_the_end` is False, damage ends the list instead of raising DamagedBlockError.
    """
    messages = list[Found]()
    position = 0
    try:
        while position < len(data):
            position = take(data, position, known, messages)
    except DamagedBlockError:
        if to_the_end:
            raise
    return messages


class RecordScan:
    """One reading of a file of records, from the first to the last; bad ones are skipped."""

    beginning: re.Pattern[bytes]
    """Of a record that reading goes on with after a bad one."""

    def __init__(self, stream: BinaryIO, path: Path) -> None:
        self.stream, self.path, self.index = stream, path, Index()
        self.size = os.fstat(stream.fileno()).st_size
        self._compressions: set[str] = set()
        self._chunks = self._stored = self._plain = 0

    def record(self, position: int) -> int:
        """Takes in the record at `position` and gives the position after it.

        Raises DamagedBlockError where there is none.
        """
        raise NotImplementedError

    def credible(self, position: int, data: bytes) -> bool:
        """Whether a record that reading can go on with begins so."""
        raise NotImplementedError

    def read_from(self, position: int) -> None:
        """All records from this position on."""
        while position < self.size:
            try:
                position = self.record(position)
            except DamagedBlockError as error:
                following = self.following(position)
                self.index.problems.append(
                    f"{self.path}: damaged or cut at byte {position} ({error}): "
                    f"{following - position} bytes skipped"
                )
                position = following

    def following(self, position: int) -> int:
        """Where the next credible record behind `position` begins, or the file's size."""
        position += 1
        while position < self.size:
            self.stream.seek(position)
            window = self.stream.read(_WINDOW_BYTES + HEAD_BYTES)
            for found in self.beginning.finditer(window):
                at = found.start()
                head = window[at : at + HEAD_BYTES]
                if at < _WINDOW_BYTES and self.credible(position + at, head):
                    return position + at
            position += _WINDOW_BYTES
        return self.size

    def note_chunk(self, compression: str, stored: int, plain: int) -> None:
        """One more chunk, of so many bytes in the file, and unpacked."""
        self._compressions.add(compression or "none")
        self._chunks, self._stored = self._chunks + 1, self._stored + stored
        self._plain += plain

    def details(self) -> list[tuple[str, str]]:
        """How the file is laid out."""
        is_packed = self._stored < self._plain
        saved = f" ({1 - self._stored / self._plain:.1%} saved)" if is_packed else ""
        names = ", ".join(sorted(self._compressions))
        chunks = [("compression", names + saved)] if names else []
        return [*chunks, ("chunks", str(self._chunks))]

    def note_unclosed(self, is_closed: Callable[[], bool]) -> None:
        """Reports a file that ends too early, where nothing else shows that it does."""
        if not self.index.problems and not is_closed():
            self.index.problems.append(
                f"{self.path}: the recording was not closed, or its end is missing"
            )
