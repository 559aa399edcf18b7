"""What the commands of `export` share: where to write, how to open, what to determine it."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import click

from cli.arguments import PATH, F
from cli.outputs import require_file, require_no_recording, require_outputs
from cli.standard_streams import end_partial, show_result


def output_option(metavar: str, text: str) -> Callable[[F], F]:
    """Adds -o/--output, a path that the text describes."""
    return click.option("-o", "--output", metavar=metavar, type=PATH, help=text)


def open_map(map_path: Path, *outputs: Path, logs: Sequence[Path] = ()) -> Any:
    """The map of a file, as a store; raises `MapError` where it is none.

    Refuses outputs that would replace the map or the logs, or any other recording.
    """
    from formats.database import open_store

    require_outputs(outputs, [map_path, *logs])
    for path in outputs:
        require_no_recording(path)

    return open_store(map_path, read_only=True)


def output_or(map_path: Path, output: Path | None, beside: Callable[[], Path]) -> Path:
    """The output that was given, else the one that is made of the map's name."""
    require_file(map_path if output is None else output)
    return beside() if output is None else output


def show_written(paths: Sequence[Path], store: Any, losses: Sequence[str] = ()) -> None:
    """Names what was written on stdout; what was left out, on stderr with exit code 3."""
    problems = [*losses, *store.problems]
    names = [str(path) for path in paths]
    show_result({"files": names, "problems": problems}, names)
    end_partial(problems)
