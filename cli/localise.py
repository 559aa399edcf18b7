"""`mapmyworld localise`: where was the robot in this finished map?"""

from __future__ import annotations

import sys
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from cli.arguments import PATH, format_option
from cli.config import config_options
from cli.exit_codes import EXIT_PARTIAL
from cli.outputs import require_outputs
from cli.progress import StderrProgress
from cli.standard_streams import show_result
from mapmyworld.errors import MapError

if TYPE_CHECKING:
    from mapmyworld.config import Config
    from mapmyworld.sensing import Plan
    from mapmyworld.types import OccupancyGrid
    from mapmyworld.types.localisation import Localisation

_KINDS = (".tum", ".csv", ".mcap", ".png")


@click.command()
@click.argument("map_path", metavar="MAP", type=PATH)
@click.argument("logs", metavar="LOG...", nargs=-1, required=True, type=PATH)
@click.option(
    "-o", "--output", "outputs", multiple=True, type=PATH,
    help="FILE.tum, .csv, .mcap or .png; may be repeated.  [default: LOG.localised.tum and .csv]",
)  # fmt: skip
@config_options
@format_option
def localise(
    map_path: Path,
    logs: tuple[Path, ...],
    outputs: tuple[Path, ...],
    config: Config,
) -> None:
    """Find where the robot of LOG was in MAP, a map.db or any grid's YAML file.

    The start is unknown: the place is searched in the whole map, then tracked, and searched again
    when the robot was carried away. MAP is never changed. The .tum file holds the poses that are
    known; .csv all moments with their state (lost, tracking, recognised), standard deviations and
    the correction map -> odom; .mcap the same as tf and poses for viewers; .png the path.

    \b
    mapmyworld localise map.db drive.mcap
    mapmyworld localise building.yaml drive.bag -o path.tum -o path.mcap -o path.png
    """
    outputs = outputs or _beside(logs[0])
    _require_places(outputs, (map_path, *logs))
    progress = StderrProgress()
    from formats.logs import open_log

    grid, plan, found = _localise(map_path, open_log(logs), config, progress)
    seen = "images" if plan.scan is None else "scans"
    for path in outputs:
        _write(path, found, grid, plan.base_frame)
    progress.finish()
    cost = progress.spent()
    summary = {
        **_facts(found),
        "wall_s": cost["wall_s"],
        "cpu_s": cost["cpu_s"],
        "files": [str(path) for path in outputs],
    }
    show_result(summary, _lines(summary, seen))
    if found.known_share < 1.0:
        unknown = f"{1.0 - found.known_share:.1%} of the {seen}"
        click.echo(f"The pose is unknown for {unknown}: see the states.", err=True)
    for loss in found.losses:
        click.echo(f"  - {loss}", err=True)
    if found.known_share < 1.0 or found.losses:
        sys.exit(EXIT_PARTIAL)


def _require_places(outputs: tuple[Path, ...], inputs: tuple[Path, ...]) -> None:
    """Refuses what could not be written or would be lost, before any work is done."""
    require_outputs(outputs, inputs)
    for path in outputs:
        if path.suffix not in _KINDS:
            raise click.UsageError(f"{path}: give a name that ends in {', '.join(_KINDS)}")
        if not path.absolute().parent.is_dir():
            raise MapError(f"{path}: its folder does not exist")


def _beside(log: Path) -> tuple[Path, ...]:
    return tuple(Path(f"{log.name}.localised{ending}") for ending in (".tum", ".csv"))


def _localise(
    map_path: Path, log: Any, config: Config, progress: StderrProgress
) -> tuple[OccupancyGrid, Plan, Localisation]:
    from mapmyworld.localisation import localise_log
    from mapmyworld.stages.plan_log import plan_log

    plan = plan_log(log, config, progress)
    if map_path.suffix in (".yaml", ".yml"):
        from formats.grid_files import read_grid

        grid = read_grid(map_path)
        return grid, plan, localise_log(grid, log, plan, config, progress)
    from formats.database import open_store

    with open_store(map_path, read_only=True) as store:
        stored = store.grid()
        if stored is None:
            raise MapError(f"{map_path}: has no grid: build it to its end first")
        return stored, plan, localise_log(store, log, plan, config, progress)


def _write(path: Path, found: Localisation, grid: OccupancyGrid, base_frame: str) -> None:
    if path.suffix == ".csv":
        from formats.localisation_files import write_localisation_csv

        write_localisation_csv(path, found)
    elif path.suffix == ".mcap":
        from formats.localisation_files import write_localisation_mcap

        write_localisation_mcap(path, found, base_frame=base_frame)
    elif path.suffix == ".png":
        from formats.report.map_pictures import write_localisation_picture

        write_localisation_picture(path, grid, found)
    else:
        from formats.trajectory_files import write_trajectory

        write_trajectory(path, found.trajectory)


def _facts(found: Localisation) -> dict[str, Any]:
    from mapmyworld.types.localisation import State

    stamps = [estimate.stamp_ns for estimate in found.estimates]
    return {
        "moments": len(stamps),
        "duration_s": (max(stamps) - min(stamps)) * 1e-9 if stamps else 0.0,
        "recognised_after_s": found.recognised_after_s,
        "times_lost": found.times_lost,
        "share": {str(state): found.share(state) for state in State},
        "known_share": found.known_share,
    }


def _lines(summary: dict[str, Any], seen: str) -> list[str]:
    after, share = summary["recognised_after_s"], summary["share"]
    speed = summary["duration_s"] / max(summary["wall_s"], 1e-9)
    localised = (
        "not localised"
        if after is None
        else f"localised:     after {after:.1f} s, then lost {summary['times_lost']} times"
    )
    return [
        localised,
        "states:        " + ", ".join(f"{name} {part:.1%}" for name, part in share.items()),
        f"pose known for {round(summary['known_share'] * summary['moments'])} of "
        f"{summary['moments']} {seen} (after smoothing)",
        f"time:          {summary['wall_s']:.1f} s ({speed:.0f}x real time), "
        f"{summary['cpu_s']:.1f} CPU s",
        *(f"written:       {path}" for path in summary["files"]),
    ]
