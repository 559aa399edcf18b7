"""The standard streams: names and JSON on them, and what if they were closed or filled."""

from __future__ import annotations

import codecs
import errno
import io
import json
import os
import sys
from collections.abc import Container, Iterable, Sequence
from typing import Any

import click

from cli.arguments import wants_json
from cli.exit_codes import EXIT_PARTIAL
from formats.readable import readable


def mend_streams() -> None:
    """Before any file is opened: words that nobody can read end no command.

    A file that took the place of a closed stream would be written into by whoever has a word to
    say, so the place is taken. What cannot be written to stderr is dropped, and of stdout what
    its reader did not wait for.
    """
    for number in range(3):
        try:
            os.fstat(number)
        except OSError:
            os.open(os.devnull, os.O_RDWR)  # which takes the lowest number that is free
    if sys.stdin is None:
        sys.stdin = io.TextIOWrapper(io.BufferedReader(io.FileIO(0, closefd=False)))
    if sys.stdout is sys.__stdout__:
        sys.stdout = _lenient(1, sys.stdout, {errno.EPIPE})
    if sys.stderr is sys.__stderr__:
        sys.stderr = _lenient(2, sys.stderr, _ALL)
    codecs.register_error(_NAMES, _as_given)
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, io.TextIOWrapper):
            stream.reconfigure(errors=_NAMES)


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
            self._dropped = _ALL  # reported once; what is left over is tried again at the very end
            raise
        return len(data) if written is None else written


class _ReadableText(io.TextIOWrapper):
    """A stream whose text may hold names from files: what a terminal would obey is written out."""

    def write(self, text: str) -> int:
        super().write(readable(text))
        return len(text)


class _OwnWords:
    """The stream below a readable one."""

    def __init__(self, stream: _ReadableText) -> None:
        self._stream = stream

    def write(self, text: str) -> int:
        return io.TextIOWrapper.write(self._stream, text)

    def __getattr__(self, name: str) -> Any:
        return getattr(self._stream, name)


def own_words(stream: Any) -> Any:
    """The stream for words of ours that colour or move the cursor: bars, counters, verdicts."""
    return _OwnWords(stream) if isinstance(stream, _ReadableText) else stream


def _lenient(number: int, before: Any, dropped: Container[int | None]) -> _ReadableText:
    """The stream of that number in the manner of the one before, None where that was closed."""
    lines = number == 2 or os.isatty(number) or (before is not None and before.line_buffering)
    return _ReadableText(
        io.BufferedWriter(_Words(number, dropped)),
        encoding="utf-8" if before is None else before.encoding,
        line_buffering=lines,
        write_through=before is not None and before.write_through,
    )


_NAMES = "mapmyworld.names"


def _as_given(error: UnicodeError) -> tuple[str | bytes, int]:
    """File names as they are, and what the stream cannot hold as `?`."""
    if not isinstance(error, UnicodeEncodeError):
        raise error
    codes = map(ord, error.object[error.start : error.end])  # of a name's bytes from 0xDC80 on
    return bytes(c - 0xDC00 if 0xDC80 <= c <= 0xDCFF else ord("?") for c in codes), error.end


def show_result(facts: Any, lines: Iterable[str]) -> None:
    """What a command found, on stdout: as JSON, or as lines of text."""
    if wants_json():
        click.echo(json.dumps(facts, indent=2, allow_nan=False, default=float))
    else:
        click.echo("\n".join(lines))


def in_columns(rows: Sequence[Sequence[str]]) -> list[str]:
    """The rows as lines, their cells aligned: the first to the left, the others to the right."""
    widths = [max(map(len, column)) for column in zip(*rows, strict=True)]
    return [
        "  ".join([row[0].ljust(widths[0]), *map(str.rjust, row[1:], widths[1:])]).rstrip()
        for row in rows
    ]


def end_partial(losses: Sequence[str]) -> None:
    """Names what is missing on stderr, and ends with that exit code; nothing where nothing is."""
    for loss in losses:
        click.echo(f"mapmyworld: {loss}", err=True)
    if losses:
        sys.exit(EXIT_PARTIAL)
