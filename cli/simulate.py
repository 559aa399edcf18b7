"""`mapmyworld simulate`: a recorded log, and its truth, from a simulated world."""

from __future__ import annotations

from pathlib import Path
from typing import Any, cast

import click

from cli.arguments import PATH, format_option
from cli.config import changed_values
from cli.outputs import require_apart, require_output_name
from cli.progress import StderrProgress
from cli.standard_streams import show_result
from formats.recording_files import LogWriter
from formats.scene_mesh import SCENE_SUFFIXES, read_scene_mesh
from formats.truth_files import truth_folder, write_truth
from mapmyworld.config import Config
from mapmyworld.config.settings import apply_settings, as_toml
from mapmyworld.errors import WorldError
from mapmyworld.simulation import WORLDS, Recording, SimulationSettings
from mapmyworld.simulation import simulate as record
from mapmyworld.simulation.world import Scene, World, scene_from_mesh
from mapmyworld.simulation.worlds import find_world


@click.command()
@click.argument("world", required=False)
@click.option("-o", "--output", type=PATH, help="LOG.mcap or LOG.bag.")
@click.option("--world", "mesh", type=PATH, help="A mesh of your own as the world.")
@click.option("--route", help="A route of the world, or steps such as '2,0 2,3 turn:90 <0,0'.")
@click.option(
    "--laps",
    type=click.IntRange(1, 1000),
    help="Laps of the route.  [default: the world's number, or 1]",
)
@click.option("--seed", type=click.IntRange(0), default=0)
@click.option("--camera/--no-camera", default=True, help="Laser-only logs take seconds.")
@click.option("--laser/--no-laser", default=True, help="Whether the robot has a laser.")
@click.option("--raw", is_flag=True, help="Raw images instead of JPEG and PNG.")
@click.option("--set", "changes", multiple=True, metavar="KEY=VALUE", help="Change a setting.")
@click.option("--list", "listing", is_flag=True, help="Print the worlds and their routes.")
@click.option("--settings", "show", is_flag=True, help="Print all settings with their meaning.")
@click.option("--overwrite", is_flag=True, help="Replace LOG if it exists.")
@format_option
def simulate(
    world: str | None,
    output: Path | None,
    mesh: Path | None,
    route: str | None,
    laps: int | None,
    seed: int,
    camera: bool,
    laser: bool,
    raw: bool,
    changes: tuple[str, ...],
    listing: bool,
    show: bool,
    overwrite: bool,
) -> None:
    """Record a log in a simulated world, with the truth beside it in LOG.truth/.

    \b
    mapmyworld simulate apartment -o flat.mcap
    mapmyworld simulate office -o office.bag --no-camera --set laser.range_max=5.6
    mapmyworld simulate --world house.glb -o house.mcap --route 'start:0,0,0 3,0 3,2 0,0'
    """
    settings = _settings(changes, camera=camera, laser=laser, raw=raw)
    if listing:
        _list_worlds()
    elif show:
        click.echo(as_toml(cast(Config, settings)), nl=False)
    else:
        place = _world(world, mesh)
        if output is None:
            raise click.UsageError("no output is named: give -o LOG.mcap or -o LOG.bag")
        require_output_name(output)
        require_apart(output, [mesh])
        recording = record(place, seed=seed, route=route, laps=laps, settings=settings)
        counts = _write(recording, output, overwrite)
        _report(recording, output, counts)


def _settings(
    changes: tuple[str, ...], *, camera: bool, laser: bool, raw: bool
) -> SimulationSettings:
    values: dict[str, Any] = dict(changed_values(changes))
    left_out = {"camera.enabled": camera, "laser.enabled": laser, "camera.compressed": not raw}
    values |= {name: False for name, kept in left_out.items() if not kept}
    return cast(SimulationSettings, apply_settings(cast(Config, SimulationSettings()), values))


def _world(name: str | None, mesh: Path | None) -> World | Scene:
    if mesh is None and name is not None and Path(name).suffix.lower() in SCENE_SUFFIXES:
        mesh = Path(name)
    if mesh is not None:
        return scene_from_mesh(read_scene_mesh(mesh))
    if name is None:
        raise WorldError(f"which world? Choose one of {', '.join(WORLDS)}, or give --world FILE")
    return find_world(name)


def _write(recording: Recording, output: Path, overwrite: bool) -> dict[str, int]:
    progress = StderrProgress()
    progress.stage("simulate", recording.duration, "s")
    counts: dict[str, int] = {}
    start_ns = recording.truth.start_ns
    with LogWriter(output, overwrite=overwrite) as log:
        for topic, message, log_time_ns in recording.messages():
            log.write(topic, message, log_time_ns)
            counts[topic] = counts.get(topic, 0) + 1
            progress.update((log_time_ns - start_ns) * 1e-9)
    progress.stage("truth")
    truth = recording.truth
    write_truth(
        truth_folder(output),
        trajectory=truth.trajectory,
        grid=truth.grid,
        mesh=truth.scene.mesh(),
        loops=truth.loop_pairs,
        calibration=truth.calibration,
    )
    progress.finish()
    return counts


def _report(recording: Recording, output: Path, counts: dict[str, int]) -> None:
    drive = recording.truth.drive
    folder = truth_folder(output)
    facts = {
        "log": str(output),
        "truth": str(folder),
        "duration_s": drive.duration,
        "length_m": drive.length,
        "loop_pairs": len(recording.truth.loop_pairs.stamps_ns),
        "messages": counts,
    }
    head = f"{output}: {drive.duration:.0f} s, {drive.length:.1f} m, truth in {folder}/"
    show_result(facts, [head, *(f"{count:>8}  {topic}" for topic, count in counts.items())])


def _list_worlds() -> None:
    facts = {w.name: {"about": w.about, "routes": dict(w.routes)} for w in WORLDS.values()}
    lines = []
    for world in WORLDS.values():
        lines.append(f"{world.name}: {world.about}")
        lines += [f"    {name:<10} {route}" for name, route in world.routes.items()]
    show_result(facts, lines)
