"""Maps merged into files, and sessions laid into one: what `merge` and `build --append` do."""

from __future__ import annotations

import sys
import tempfile
from collections.abc import Sequence
from contextlib import ExitStack
from pathlib import Path
from typing import Any

import click

from cli.exit_codes import EXIT_PARTIAL
from cli.outputs import (
    forget_products,
    products_of,
    require_map_place,
    require_no_other,
    require_output_name,
)
from cli.progress import StderrProgress
from cli.standard_streams import show_result
from cli.storing import ResultMaps, build_into, numbered, products_beside, storage_arguments
from formats.database import MemoryMap, open_store
from formats.database.lock import only_writer
from formats.logs import open_log
from mapmyworld.config import Config
from mapmyworld.errors import MapError
from mapmyworld.sessions import MergedMap, SessionMap, extend_map, load_session_map, merge_maps


def merge_files(
    sources: Sequence[Path],
    output: Path,
    config: Config,
    progress: StderrProgress,
    *,
    export: bool,
) -> dict[str, Any]:
    """Writes OUTPUT, and OUTPUT_2, ... for what does not connect; nothing if anything fails.

    OUTPUT may be a source here.
    """
    with only_writer(output), ResultMaps(output, config) as results:
        with ExitStack() as stack:
            session_maps = [_opened(path, stack) for path in sources]
            maps = merge_maps(session_maps, results.open, config, progress)
        results.put_in_place()
    return _summary(maps, results.names, config, progress, export)


def extend_file(
    known: Path, sources: Sequence[Path], config: Config, progress: StderrProgress, *, export: bool
) -> dict[str, Any]:
    """Lays the sources' sessions into the map KNOWN.

    What shows another place goes into KNOWN_2, or the next number that is free. Sessions that
    contradict the map are merged with it instead.
    """
    with only_writer(known), ResultMaps(known, config, spare=True) as results, ExitStack() as stack:
        session_maps = [_opened(path, stack) for path in sources]
        with results.copy_of_output() as store:
            done = extend_map(store, session_maps, MemoryMap, config, progress)
            nodes = store.nodes()
        if done is None:
            results.discard()
            session_maps.insert(0, _opened(known, stack))
            maps = merge_maps(session_maps, results.open, config, progress, first=str(known))
        else:
            names = (str(known), *(session_map.name for session_map in done.added))
            sessions = len({node.session for node in nodes})
            maps = [MergedMap(names, sessions, len(nodes), done.links)]
            if done.apart:
                maps += merge_maps(done.apart, results.open, config, progress)
        results.put_in_place()
    return _summary(maps, results.names, config, progress, export)


def _opened(path: Path, stack: ExitStack) -> SessionMap:
    store = open_store(path, read_only=True)
    stack.callback(store.close)
    return load_session_map(str(path), store)


def _summary(
    maps: Sequence[MergedMap],
    results: Sequence[Path],
    config: Config,
    progress: StderrProgress,
    export: bool,
) -> dict[str, Any]:
    """What resulted; what stands beside each map is written anew, or reported to be of another."""
    beside: list[str] = []
    for path, made in zip(results, maps, strict=True):
        if export:
            forget_products(path)
            with open_store(path, read_only=True) as store:
                beside += products_beside(store, path, config, progress)[0]
        elif made.names != (str(path),) and (stale := products_of(path)):  # else it is what it was
            named = ", ".join(product.name for product in stale)
            progress.note(f"{named}: of the map before; `mapmyworld export` writes them anew")
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
        **progress.spent(),
    }


def require_maps(paths: Sequence[Path]) -> None:
    """Raises `MapError` for what cannot be merged, before any work is done."""
    absent = [str(path) for path in paths if not path.is_file()]
    if absent:
        raise MapError("no such map:", problems=absent)
    twice = sorted({str(path) for path in paths if list(paths).count(path) > 1})
    if twice:
        raise MapError("a map cannot be merged with itself:", problems=twice)


def require_results(output: Path, maps: Sequence[Path], *, export: bool) -> None:
    """Refuses an output that would replace one of the maps, or what is no map of ours."""
    require_output_name(output)
    for number in range(len(maps)):
        path = numbered(output, number)
        require_map_place(path, maps, export=export)
        require_no_other(path)


def show_merged(summary: dict[str, Any]) -> None:
    """Prints what resulted; exits with 3 where sessions stay apart."""
    lines = [
        f"{made['file']}: {made['sessions']} sessions, {made['nodes']} nodes, "
        f"{made['links']} constraints between sessions; of {', '.join(made['of'])}"
        for made in summary["maps"]
    ]
    cost = f"{summary['cpu_s']:.1f} CPU s, {summary['peak_memory_mb']:.0f} MB at most"
    show_result(summary, [*lines, f"time: {cost}"])
    if len(summary["maps"]) > 1:
        click.echo(
            f"the sessions do not all show the same place: {len(summary['maps'])} maps were "
            "written, which nothing connects",
            err=True,
        )
        sys.exit(EXIT_PARTIAL)


def append_logs(
    logs: Sequence[Path], map_path: Path, config: Config, *, export: bool
) -> dict[str, Any]:
    """Builds a map of each log and lays it into MAP, which is replaced when all is done.

    What is counted is the cost of laying alone.
    Raises `MapError` where MAP's folder does not exist.
    """
    if not map_path.absolute().parent.is_dir():
        raise MapError(f"{map_path}: its folder does not exist")
    with tempfile.TemporaryDirectory(dir=map_path.absolute().parent, prefix=".append-") as folder:
        built = [
            _build(log, Path(folder) / f"{number}" / f"{log.stem}.db", config)
            for number, log in enumerate(logs)
        ]
        progress = StderrProgress()
        if map_path.exists():
            summary = extend_file(map_path, built, config, progress, export=export)
        else:
            summary = merge_files(built, map_path, config, progress, export=export)
        names = {str(path): str(log) for path, log in zip(built, logs, strict=True)}
    progress.finish()
    for made in summary["maps"]:
        made["of"] = [names.get(name, name) for name in made["of"]]
    return summary


def _build(log: Path, path: Path, config: Config) -> Path:
    progress = StderrProgress()
    path.parent.mkdir()
    with open_store(path, create=True, **storage_arguments(config)) as store:
        build_into(store, open_log([log]), config, progress)
    progress.finish()  # a log's stages are distinguished from the next one's
    return path
