"""What the commands of `export` share: where to write, how to open, what to tell."""

from __future__ import annotations

import sys
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any, TypeVar

import click

from cli.common import EXIT_PARTIAL

F = TypeVar("F", bound=Callable[..., Any])


def output_option(metavar: str, text: str) -> Callable[[F], F]:
    """Adds -o/--output, a path that the text describes."""
    return click.option(
        "-o", "--output", metavar=metavar, type=click.Path(path_type=Path), help=text
    )


def save_option(command: F) -> F:
    """Adds --save-in-map to a command."""
    return click.option(
        "--save-in-map", is_flag=True, help="Also into MAP, for RTAB-Map's viewer to show."
    )(command)


def open_map(map_path: Path, *, read_only: bool = True) -> Any:
    """The map of a file, as a store; raises `MapError` where it is none."""
    from formats.database import open_store

    return open_store(map_path, read_only=read_only)


def tell(paths: Sequence[Path], store: Any, losses: Sequence[str] = ()) -> None:
    """Names what was written on stdout; what was left out, on stderr with exit code 3."""
    for path in paths:
        click.echo(str(path))
    problems = [*losses, *store.problems]
    for problem in problems:
        click.echo(f"mapmyworld: {problem}", err=True)
    if problems:
        sys.exit(EXIT_PARTIAL)
