"""Maps merged into files: what `merge` and `build --append` share."""

from __future__ import annotations

import os
import resource
import sys
import time
from collections.abc import Iterator, Sequence
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from cli.common import EXIT_PARTIAL, show_json
from cli.progress import StderrProgress
from cli.storing import storage_arguments
from mapmyworld.errors import MapError

if TYPE_CHECKING:
    from mapmyworld.config import Config
    from mapmyworld.types import MapStore


def merge_files(
    sources: Sequence[Path],
    output: Path,
    config: Config,
    progress: StderrProgress,
    *,
    first: Path | None = None,
    export: bool = True,
) -> dict[str, Any]:
    """Writes OUTPUT, and OUTPUT_2, ... for what does not connect; nothing if anything fails.

    `first` names the source whose sessions go into OUTPUT itself. OUTPUT may be a source.
    """
    from formats.database import open_store
    from formats.database.lock import only_writer
    from mapmyworld.sessions import load_unit, merge_maps

    started, cpu = time.monotonic(), time.process_time()
    written: list[Path] = []

    @contextmanager
    def new_store(number: int) -> Iterator[MapStore]:
        path = _unfinished(output, number)
        stored = storage_arguments(config)
        with open_store(path, create=True, overwrite=True, **stored) as store:
            written.append(path)
            yield store

    try:
        with only_writer(output):
            with ExitStack() as stack:
                units = []
                for path in sources:
                    store = open_store(path, read_only=True)
                    stack.callback(store.close)
                    units.append(load_unit(str(path), store))
                wanted = None if first is None else str(first)
                maps = merge_maps(units, new_store, config, progress, first=wanted)
            for number, path in enumerate(written):
                os.replace(path, numbered(output, number))
    finally:
        for path in written:
            path.unlink(missing_ok=True)
    results = [numbered(output, number) for number in range(len(maps))]
    beside = [line for path in results if export for line in _export(path, config, progress)]
    return {
        "maps": [
            {
                "file": str(path),
                "of": list(made.names),
                "sessions": made.sessions,
                "nodes": made.nodes,
                "links": made.links,
            }
            for path, made in zip(results, maps, strict=True)
        ],
        "files": [*map(str, results), *beside],
        "wall_s": time.monotonic() - started,
        "cpu_s": time.process_time() - cpu,
        "peak_memory_mb": resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024,
    }


def numbered(output: Path, number: int) -> Path:
    """OUTPUT for the first map, OUTPUT_2 for the second, ..."""
    return output if number == 0 else output.with_stem(f"{output.stem}_{number + 1}")


def _unfinished(output: Path, number: int) -> Path:
    path = numbered(output, number)
    return path.with_name(f".{path.name}.part")


def _export(path: Path, config: Config, progress: StderrProgress) -> list[str]:
    """What `build` writes beside its database."""
    from cli.exporting import export_cloud, export_grid, export_trajectory
    from formats.database import open_store

    stem = path.with_suffix("")
    progress.stage("export")
    with open_store(path, read_only=True) as store:
        made = export_grid(store, stem)
        made += export_trajectory(store, stem.with_suffix(".tum"))
        made += export_cloud(store, stem.with_suffix(".ply"), config)
    return [str(file) for file in made]


def require_maps(paths: Sequence[Path]) -> None:
    """Refuses what cannot be merged before any work is done."""
    absent = [str(path) for path in paths if not path.is_file()]
    if absent:
        raise MapError("no such map:", problems=absent)
    twice = sorted({str(path) for path in paths if list(paths).count(path) > 1})
    if twice:
        raise MapError("a map cannot be merged with itself:", problems=twice)


def show_merged(summary: dict[str, Any], style: str) -> None:
    """Prints what resulted; exits with 3 where sessions stay apart."""
    if style == "json":
        show_json(summary)
    else:
        for made in summary["maps"]:
            click.echo(
                f"{made['file']}: {made['sessions']} sessions, {made['nodes']} nodes, "
                f"{made['links']} constraints between sessions; of {', '.join(made['of'])}"
            )
        click.echo(
            f"time: {summary['cpu_s']:.1f} CPU s, {summary['peak_memory_mb']:.0f} MB at most"
        )
    if len(summary["maps"]) > 1:
        click.echo(
            f"the sessions do not all show the same place: {len(summary['maps'])} maps were "
            "written, which nothing connects",
            err=True,
        )
        sys.exit(EXIT_PARTIAL)
