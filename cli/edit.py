"""`mapmyworld edit`: a person's statements about the graph, from a text file."""

from __future__ import annotations

from pathlib import Path

import click

from cli.arguments import PATH, map_argument
from cli.exit_codes import EXIT_PARTIAL
from cli.progress import StderrProgress
from cli.settings import config_options, load_config
from mapmyworld.errors import GraphError, MapError


@click.command()
@map_argument
@click.argument("edits_path", metavar="EDITS.toml", type=PATH)
@config_options
@click.option("-q", "--quiet", is_flag=True, help="No progress and no notes.")
def edit(
    map_path: Path,
    edits_path: Path,
    config_path: Path | None,
    changes: tuple[str, ...],
    quiet: bool,
) -> None:
    """Accept, reject or add constraints of MAP, pin nodes, add priors; then optimise again.

    EDITS.toml replaces the edits that MAP has; an empty file undoes them. The next `build` of the
    same log into MAP replays them. `mapmyworld inspect graph` prints lines to paste.

    \b
    [[reject]]
    from = 12
    to = 340
    reason = "two identical corridors"
    \b
    mapmyworld edit map.db edits.toml
    """
    config = load_config(config_path, changes)
    from formats.database import open_store
    from formats.database.lock import only_writer
    from formats.edits import read_edits
    from mapmyworld.graph.edits import edits_to_json, resolve_pins, unmet
    from mapmyworld.stages.maps import draw_maps
    from mapmyworld.stages.recognise import scan_loader
    from mapmyworld.stages.solve import solve_and_judge

    edits = read_edits(edits_path)
    progress = StderrProgress(quiet=quiet)
    with only_writer(map_path), open_store(map_path) as store:
        poses = store.poses()
        if poses is None:
            raise MapError(f"{map_path}: its graph is not solved yet: finish `build` first")
        before = sum(c.accepted for c in store.constraints())
        resolved = resolve_pins(edits, poses)
        if problems := unmet(store.constraints(), resolved):
            raise GraphError("the edits do not fit this map:", problems=problems)
        store.put("edits", edits_to_json(resolved))
        with store.write_stage("optimise", "edit"):  # anew, as `build` does: without what it found
            solve_and_judge(store, config, progress, scan_loader(store, config))
        with store.write_stage("map", "edit"):
            draw_maps(store, config, progress)
        progress.finish()
        constraints, solved = store.constraints(), store.get("solve") or {}
    now = sum(c.accepted for c in constraints)
    click.echo(f"{len(edits)} edits applied: {before} -> {now} constraints accepted")
    losses = solved.get("losses", [])
    for loss in losses:
        click.echo(f"mapmyworld: {loss}", err=True)
    if losses:
        raise SystemExit(EXIT_PARTIAL)
