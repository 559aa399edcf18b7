"""The standard streams, where whoever started the program closed or filled them."""

from __future__ import annotations

import errno
import io
import os
import sys
from collections.abc import Container
from typing import Any


def mend_streams() -> None:
    """Before any file is opened: words that nobody can read end no command.

    A file that took the place of a closed stream would be written into by whoever has a word to
    say, so the place is taken. What cannot be written to stderr is dropped, and of stdout what
    its reader did not wait for.
    """
    for number in range(3):
        _take_place(number)
    if sys.stdin is None:
        sys.stdin = io.TextIOWrapper(io.BufferedReader(io.FileIO(0, closefd=False)))
    if sys.stdout is sys.__stdout__:
        sys.stdout = _lenient(1, sys.stdout, {errno.EPIPE})
    if sys.stderr is sys.__stderr__:
        sys.stderr = _lenient(2, sys.stderr, _ALL)


def _take_place(number: int) -> None:
    try:
        os.fstat(number)
    except OSError:
        os.open(os.devnull, os.O_RDWR)  # which takes the lowest number that is free


_ALL = frozenset(errno.errorcode)


class _Words(io.FileIO):
    """A stream into which writing does not fail with these errors."""

    def __init__(self, number: int, dropped: Container[int | None]) -> None:
        super().__init__(number, "w", closefd=False)
        self._dropped = dropped

    def write(self, data: Any) -> int:
        try:
            written = super().write(data)
        except OSError as error:
            if error.errno in self._dropped:
                return len(data)
            self._dropped = _ALL  # told once; what is left over is tried again at the very end
            raise
        return len(data) if written is None else written


def _lenient(number: int, before: Any, dropped: Container[int | None]) -> io.TextIOWrapper:
    """The stream of that number in the manner of the one before, None where that was closed."""
    lines = number == 2 or os.isatty(number) or (before is not None and before.line_buffering)
    return io.TextIOWrapper(
        io.BufferedWriter(_Words(number, dropped)),
        encoding="utf-8" if before is None else before.encoding,
        errors="backslashreplace" if before is None else before.errors,
        line_buffering=lines,
        write_through=before is not None and before.write_through,
    )
