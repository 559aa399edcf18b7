"""`mapmyworld build`: a recorded log becomes a map."""

from __future__ import annotations

import sys
from dataclasses import asdict
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from cli.arguments import PATH, default_map, format_option, wants_json
from cli.config import config_options, options_of
from cli.exit_codes import EXIT_PARTIAL
from cli.outputs import forget_products, require_map_place
from cli.progress import StderrProgress, rate_text
from cli.repeating import repeat_and_compare
from cli.standard_streams import show_result
from cli.storing import build_into, no_empty_map, products_beside, storage_arguments
from mapmyworld.errors import MapError

if TYPE_CHECKING:
    from mapmyworld.config import Config
    from mapmyworld.types import LogSource


@click.command()
@click.argument("paths", metavar="LOG...", nargs=-1, required=True, type=PATH)
@click.option(
    "-o",
    "--output",
    "map_path",
    default=default_map,
    show_default=False,
    type=PATH,
    help="The map database to write.  [default: map.db]",
)
@config_options
@click.option(
    "--method",
    type=click.Choice(["graph", "fastslam"]),
    default="graph",
    help="GraphSLAM, or grid-based FastSLAM (particles).",
)
@click.option(
    "--append", "append_to", metavar="MAP", type=PATH,
    help="Add each LOG to MAP as a session of its own, where it shows the same place.",
)  # fmt: skip
@click.option("--resume", is_flag=True, help="Go on with an unfinished map; it must exist.")
@click.option("--overwrite", is_flag=True, help="Start anew even if the map exists.")
@click.option("--no-export", is_flag=True, help="Write map.db only.")
@click.option("--dry-run", is_flag=True, help="Print the plan and stop.")
@click.option("--verify-repeat", is_flag=True, help="Build twice; refuse if any byte differs.")
@click.option(
    "--max-memory",
    type=click.IntRange(1),
    metavar="MB",
    help="Stop cleanly above this limit; the build can be resumed.",
)
@format_option
def build(
    paths: tuple[Path, ...],
    map_path: Path,
    config: Config,
    method: str,
    append_to: Path | None,
    resume: bool,
    overwrite: bool,
    no_export: bool,
    dry_run: bool,
    verify_repeat: bool,
    max_memory: int | None,
) -> None:
    """Turn LOG into a map: map.db, and beside it the products.

    map.pgm + map.yaml are the grid, map.ply the cloud (where there is depth), map.tum the
    trajectory, map.html the report; map.timing.json says what each stage took.

    Several LOGs that belong to one session (split bags) are one log; other sessions are refused.
    A map that exists already is continued: stages that are done with the same inputs are not
    done again.

    \b
    mapmyworld build drive.mcap
    mapmyworld build drive_0.bag drive_1.bag -o office.db --set mapping.resolution=0.025
    mapmyworld build --append office.db tuesday.bag wednesday.bag
    """
    if resume and overwrite:
        raise click.UsageError("--resume and --overwrite exclude each other")
    if not dry_run:
        require_map_place(append_to or map_path, paths, export=not no_export)
    if append_to is not None:
        if resume or overwrite or dry_run or verify_repeat or method != "graph":
            raise click.UsageError("--append goes with none of the other ways to build")
        from cli.merging import append_logs, show_merged

        show_merged(append_logs(paths, append_to, config, export=not no_export))
        return
    from formats.logs import open_log

    log = open_log(paths)
    if dry_run:
        _show_plan(log, config)
        return
    if resume and not map_path.exists():
        raise MapError(f"{map_path}: there is no map to resume; omit --resume to begin one")
    from formats.database import open_store
    from formats.database.lock import only_writer

    progress, stored = StderrProgress(max_memory), storage_arguments(config)
    opening = partial(open_store, map_path, create=True, overwrite=overwrite, **stored)
    with only_writer(map_path), no_empty_map(map_path), opening() as store:
        result = build_into(store, log, config, progress, method)
        if overwrite and not no_export:
            forget_products(map_path)
        given = (store, map_path, config, progress, result.duration_s)
        reused = bool(result.reused_stages)
        written, cost = products_beside(*given, export=not no_export, continued=reused)
    summary = {**asdict(result), "files": [str(map_path), *written], **cost}
    progress.finish()
    if verify_repeat:
        same_options = [*options_of(config), "--method", method]
        same_options += ["--no-export"] if no_export else []
        repeat_and_compare(paths, map_path, summary["files"], same_options)
    show_result(summary, _summary_lines(summary))
    if summary["losses"]:
        if not wants_json():
            click.echo("partial map; lost or assumed:", err=True)
            for loss in summary["losses"]:
                click.echo(f"  - {loss}", err=True)
        sys.exit(EXIT_PARTIAL)


def _show_plan(log: LogSource, config: Config) -> None:
    """The plan; exit code 3 where the map would be partial, as of `inspect log`."""
    from cli.inspect_log import plan_json, plan_lines
    from mapmyworld.sensing import make_plan, survey_log

    survey = survey_log(log)
    plan = make_plan(survey, config.sensing)
    show_result(plan_json(plan), plan_lines(plan))
    if plan.losses or survey.info.problems:
        sys.exit(EXIT_PARTIAL)


def _summary_lines(summary: dict[str, Any]) -> list[str]:
    lines = [
        f"nodes:         {summary['nodes']} from {summary['frames']} frames, "
        f"{summary['distance_m']:.1f} m in {summary['duration_s']:.0f} s",
    ]
    for kind, counts in summary["constraints"].items():
        lines.append(f"{kind + ':':<14} {counts['accepted']} accepted of {counts['tried']} tried")
    if summary["reused_stages"]:
        lines.append(
            f"reused:        {', '.join(summary['reused_stages'])} (same inputs as before)"
        )
    speed = rate_text(summary["real_time_factor"])
    lines.append(
        f"time:          {summary['wall_s']:.1f} s ({speed}x real time), "
        f"{summary['cpu_s']:.1f} CPU s, {summary['peak_memory_mb']:.0f} MB at most"
    )
    lines += [f"written:       {path}" for path in summary["files"]]
    return lines
