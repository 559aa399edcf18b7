"""Arguments and options that many commands take."""

from __future__ import annotations

import os
from collections.abc import Callable
from pathlib import Path
from typing import Any, TypeVar

import click

PATH = click.Path(path_type=Path, readable=False)  # what cannot be read is recognised by its reader

F = TypeVar("F", bound=Callable[..., Any])
_LARGEST = 1e9  # metres, seconds or shares: beyond it products overflow


class FiniteRange(click.FloatRange):
    """A number that an option takes, from its least value on; neither NaN nor beyond all sense."""

    def convert(
        self, value: Any, param: click.Parameter | None, ctx: click.Context | None
    ) -> float:
        """The number; click's own ranges let NaN pass."""
        number = float(super().convert(value, param, ctx))
        if not abs(number) <= _LARGEST:
            self.fail(f"{value} is no number up to {_LARGEST:g}.", param, ctx)
        return number


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
