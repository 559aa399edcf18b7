"""`mapmyworld compare`: several maps of one log side by side."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from cli.arguments import PATH, british, format_option
from cli.config import config_options, options_of
from cli.manners import note
from cli.outputs import require_outputs
from cli.repeating import run_build
from cli.standard_streams import show_result

if TYPE_CHECKING:
    from cli.comparing import Candidate
    from mapmyworld.config import Config

_METHODS = ("graph", "fastslam", "neighbour")


@click.command()
@click.argument("paths", metavar="MAP...", nargs=-1, required=True, type=PATH)
@click.option(
    "--methods",
    metavar="LIST",
    help="Build the maps of a LOG first: graph, fastslam, neighbour (tracking without closures).",
)
@click.option(
    "-o",
    "--output",
    "folder",
    type=click.Path(path_type=Path, file_okay=False, readable=False),
    default=Path("compare"),
    help="Folder for the maps that --methods builds.",
)
@click.option("--reference", type=PATH, help="True trajectory, a TUM file or a MAP.")
@click.option("--relations", type=PATH, help="Known relative poses.")
@click.option("--image", type=PATH, help="Draw all maps into one PNG.")
@config_options
@format_option
def compare(
    paths: tuple[Path, ...],
    methods: str | None,
    folder: Path,
    reference: Path | None,
    relations: Path | None,
    image: Path | None,
    config: Config,
) -> None:
    """Accuracy, sharpness, time and memory of several MAPs of one log, side by side.

    Accuracy needs the truth (--reference) or known relative poses (--relations). Sharpness needs
    neither: a better map has less entropy a cell and thinner walls. With --methods, MAP is a LOG
    (or several that are one session), and its maps are built first, into a folder.

    \b
    mapmyworld compare graph.db particles.db --relations intel.relations --image both.png
    mapmyworld compare drive.mcap --methods graph,fastslam,neighbour --reference truth.tum
    """
    from cli.comparing import draw_maps, figures_of, read_candidate, table_lines
    from cli.scoring import read_any_trajectory
    from formats.relation_files import read_relations

    require_outputs([image], [*paths, reference, relations])
    truth = None if reference is None else read_any_trajectory(reference)
    known = None if relations is None else read_relations(relations)
    if methods is None:
        candidates = [read_candidate(path) for path in paths]
    else:
        candidates = _built(paths, _chosen(methods), folder, config)
    rows = [figures_of(c, candidates[0], truth, known) for c in candidates]
    if image is not None:
        draw_maps(image, candidates, rows)
    show_result({"maps": rows}, table_lines(rows))


def _chosen(methods: str) -> list[str]:
    names = [british(name.strip()) for name in methods.split(",") if name.strip()]
    unknown = [name for name in names if name not in _METHODS]
    if unknown or not names:
        raise click.UsageError(
            f"--methods {methods}: unknown {', '.join(unknown) or 'nothing'}; "
            f"choose from {', '.join(_METHODS)}"
        )
    return list(dict.fromkeys(names))


def _built(
    logs: tuple[Path, ...], methods: list[str], folder: Path, config: Config
) -> list[Candidate]:
    """The log's map by each method; neighbour constraints alone come with the graph."""
    from cli.comparing import read_candidate, without_closures
    from formats.database import open_store

    folder.mkdir(parents=True, exist_ok=True)
    options = options_of(config)
    candidates: list[Candidate] = []
    for method in methods:
        source = "graph" if method == "neighbour" else method
        path = folder / f"{source}.db"
        if method != "neighbour" or "graph" not in methods[: methods.index(method)]:
            summary = _build(logs, source, path, options)
        if method == "neighbour":
            with open_store(path, read_only=True) as store:
                candidates.append(without_closures(store, config))
        else:
            candidates.append(replace(read_candidate(path), name=method, summary=summary))
    return candidates


def _build(logs: tuple[Path, ...], method: str, path: Path, options: list[str]) -> dict[str, Any]:
    """Builds one map in a process of its own, so that time and memory are its own."""
    arguments = [*map(str, logs), "-o", str(path), "--method", method, "--overwrite"]
    arguments += ["--no-export", "--format", "json", *options]
    note(f"building {path} by {method}")
    summary: dict[str, Any] = json.loads(run_build(arguments, f"{path}: building by {method}"))
    return summary
