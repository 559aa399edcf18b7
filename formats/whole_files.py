"""Files that are read at once, and either written whole or not at all."""

from __future__ import annotations

import os
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from mapmyworld.errors import MapError


def write_whole(path: Path, data: bytes | str) -> None:
    """Puts data (text as UTF-8, `utf8_of`) in place of the file in one step.

    Killed at any moment, or with the disk full, it leaves what was there before. Raises MapError.
    """
    if not path.parent.is_dir():
        raise MapError(f"{path}: cannot be written: its folder does not exist")
    if path.is_dir():
        raise MapError(f"{path}: cannot be written: it is a folder")
    try:
        with whole_path(path) as part:
            part.write_bytes(utf8_of(data) if isinstance(data, str) else data)
    except OSError as error:
        raise MapError(f"{path}: cannot be written: {error.strerror or error}") from error


def read_whole(path: Path) -> bytes:
    """The bytes of a file; `MapError` where it cannot be read."""
    try:
        return path.read_bytes()
    except OSError as error:
        raise MapError(f"{path}: cannot be read: {error.strerror or error}") from None


def utf8_of(text: str) -> bytes:
    """Text as UTF-8, with a mark in place of bytes in file names that are none."""
    try:
        given = text.encode("utf-8", "surrogateescape")
    except UnicodeEncodeError:  # half a character, as JSON can hold it
        given = text.encode("utf-8", "replace")
    return given.decode("utf-8", "replace").encode()


@contextmanager
def whole_path(path: Path) -> Iterator[Path]:
    """A place beside `path` for a file that takes its place at the end, and not before."""
    part = path.with_name(f"{path.name}.part")
    try:
        yield part
        os.replace(part, path)
    finally:
        with suppress(OSError):
            part.unlink(missing_ok=True)
