"""Arguments and options that many commands take."""

from __future__ import annotations

import os
from collections.abc import Callable
from pathlib import Path
from typing import Any, TypeVar

import click

PATH = click.Path(path_type=Path, readable=False)  # what cannot be read is told by its reader

F = TypeVar("F", bound=Callable[..., Any])


def default_map() -> Path:
    """`$MAPMYWORLD_MAP`, or `map.db` in the current folder."""
    return Path(os.environ.get("MAPMYWORLD_MAP", "map.db"))


def map_argument(command: F) -> F:
    """Adds the optional argument MAP, a finished map, to a command."""
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
