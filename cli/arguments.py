"""Arguments and options that many commands take, and names as half of the world spells them."""

from __future__ import annotations

import difflib
import os
import re
from collections.abc import Callable, Collection
from pathlib import Path
from typing import Any, TypeVar

import click

PATH = click.Path(path_type=Path, readable=False)  # what cannot be read is recognised by its reader
F = TypeVar("F", bound=Callable[..., Any])
_LARGEST = 1e9  # metres, seconds or shares: beyond it products overflow
_BRITISH = {
    "localize": "localise",
    "optimize": "optimise",
    "optimized": "optimised",
    "neighbor": "neighbour",
}


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


def map_and(arguments: tuple[Path | str, ...], last: str) -> tuple[Path, str]:
    """MAP, or the default one, and what came after it, which is called `last` in a message."""
    if len(arguments) > 2:
        raise click.UsageError(f"give [MAP] and {last}")
    return Path(arguments[0]) if len(arguments) == 2 else default_map(), str(arguments[-1])


def format_option(command: F) -> F:
    """Adds --format text|json to a command, for `wants_json`."""
    kinds, text = click.Choice(["text", "json"]), "How to print the result."
    return noted_option("--format", type=kinds, default="text", help=text)(command)


def wants_json() -> bool:
    """Whether the command that runs was given --format json."""
    return bool(noted("format") == "json")


def noted_option(
    *names: str, act: Callable[..., None] | None = None, **more: Any
) -> Callable[[F], F]:
    """Adds an option that is no parameter of the command: `noted` tells it by its long name.

    `act` is called with the context and the value.
    """

    def keep(context: click.Context, parameter: click.Parameter, value: Any) -> None:
        context.meta[f"mapmyworld.{parameter.name}"] = value
        if act is not None and value and not context.resilient_parsing:
            act(context, value)

    return click.option(*names, expose_value=False, callback=keep, **more)


def noted(name: str) -> Any:
    """What the command that runs was given for an option; None where it has none of that name."""
    context = click.get_current_context(silent=True)
    return None if context is None else context.meta.get(f"mapmyworld.{name}")


def british(text: str) -> str:
    """The text with its words spelt as the names here are: `graph.constraints.neighbour.tried`."""
    return re.sub("[a-z]+", lambda word: _BRITISH.get(word[0], word[0]), text)


def meant(name: str, known: Collection[str]) -> str:
    """The name that was probably meant, as a question behind a full stop; empty where none is."""
    near = difflib.get_close_matches(name, known, n=1)
    return f" Did you mean {near[0]!r}?" if near else ""


def settings_named(option: str) -> list[str]:
    """Full names of the settings that an option like --resolution asks for."""
    from mapmyworld.config.settings import list_settings

    wanted = option.lstrip("-").replace("-", "_")
    tails = [(one.name.rpartition(".")[2], one.name) for one in list_settings()]
    near = difflib.get_close_matches(wanted, {tail for tail, _ in tails}, n=1, cutoff=0.8)
    return [name for tail, name in tails if tail in near]
