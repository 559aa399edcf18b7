"""What commands share: options, the partial-result exit code, and text or JSON on stdout."""

from __future__ import annotations

import codecs
import json
import os
from collections.abc import Callable
from pathlib import Path
from typing import Any, TypeVar

import click

EXIT_USAGE = 1
EXIT_BAD_INPUT = 2
EXIT_PARTIAL = 3
EXIT_CHECK_FAILED = 4
EXIT_INTERRUPTED = 130
PATH = click.Path(path_type=Path, readable=False)  # what cannot be read is told by its reader

F = TypeVar("F", bound=Callable[..., Any])


def default_map() -> Path:
    """`$MAPMYWORLD_MAP`, or `map.db` in the current folder."""
    return Path(os.environ.get("MAPMYWORLD_MAP", "map.db"))


def map_argument(command: F) -> F:
    """The optional MAP argument that every command after `build` takes."""
    return click.argument(
        "map_path",
        metavar="[MAP]",
        required=False,
        default=default_map,
        type=PATH,
    )(command)


def format_option(command: F) -> F:
    """Adds --format text|json to a command, as its parameter `style`."""
    return click.option(
        "--format",
        "style",
        type=click.Choice(["text", "json"]),
        default="text",
        show_default=True,
        help="How to print the result.",
    )(command)


def shown(name: str) -> str:
    """A file's name as text that any encoding of Unicode can hold."""
    return os.fsencode(name).decode("utf-8", "replace")


def keep_names(stream: Any) -> None:
    """From now on the stream prints file names as they are, and what it cannot hold as `?`."""
    codecs.register_error(_NAMES, _as_given)
    if hasattr(stream, "reconfigure"):
        stream.reconfigure(errors=_NAMES)


_NAMES = "mapmyworld.names"


def _as_given(error: UnicodeError) -> tuple[str | bytes, int]:
    if not isinstance(error, UnicodeEncodeError):
        raise error
    letters = error.object[error.start : error.end]
    return b"".join(_byte_of(ord(letter)) for letter in letters), error.end


def _byte_of(code: int) -> bytes:
    """The byte for which Python's names of files have this code."""
    return bytes([code - 0xDC00]) if 0xDC80 <= code <= 0xDCFF else b"?"


def show_json(value: Any) -> None:
    """One JSON document on stdout."""
    click.echo(json.dumps(value, indent=2, allow_nan=False, default=float))
