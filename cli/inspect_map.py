"""`mapmyworld inspect map`: sessions, length, duration, area, quality."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import click
import numpy as np

from cli.arguments import PATH, format_option, map_argument
from cli.outputs import require_outputs
from cli.standard_streams import show_result
from formats.database import open_store
from mapmyworld.errors import MapError
from mapmyworld.types import MapStore, OccupancyGrid


@click.command("map")
@map_argument
@click.option(
    "--image",
    type=PATH,
    help="Draw the particles' paths over the grid into this PNG (--method fastslam).",
)
@format_option
def inspect_map(map_path: Path, image: Path | None) -> None:
    """What MAP covers: sessions, length, duration, area, quality, and how it was made.

    \b
    mapmyworld inspect map
    mapmyworld inspect map office.db --format json
    """
    require_outputs([image], [map_path])
    with open_store(map_path, read_only=True) as store:
        facts = map_facts(store)
        if not facts["nodes"]:
            raise MapError(f"{map_path}: holds no nodes: its build did not get that far")
        if image is not None:
            _draw_particles(store, image)
    show_result(facts, _lines(facts))


def _draw_particles(store: MapStore, path: Path) -> None:
    paths, grid = store.get("particle_paths"), store.grid()
    if paths is None or grid is None:
        raise MapError(
            f"{path}: this map was not made by particles; `inspect graph --image` draws its graph"
        )
    from formats.report.map_pictures import write_particle_picture

    branches = np.array(paths["branches"], np.float32).reshape(-1, 2, 2)
    best = np.array(paths["path"], np.float32).reshape(-1, 2)
    loops = np.array(paths["loops"], np.float32).reshape(-1, 2)
    write_particle_picture(path, grid, branches, best, loops)
    click.echo(f"drew {path}", err=True)


def map_facts(store: MapStore) -> dict[str, Any]:
    """Everything that `inspect map` shows."""
    from mapmyworld.graph.audit import sigmas_of
    from mapmyworld.map_figures import map_figures

    figures, poses, grid = map_figures(store), store.poses(), store.grid()
    facts: dict[str, Any] = {
        "sessions": figures.sessions,
        "nodes": figures.nodes,
        "frames": figures.frames,
        "duration_s": figures.duration_s,
        "solved": poses is not None,
    }
    if poses is not None:
        facts["length_m"] = figures.path_m
        facts["closures"] = figures.closures
        facts["components"] = len(figures.components)
        if poses.covariances is not None and len(poses.covariances):
            facts["largest_sigma_m"] = float(sigmas_of(poses.covariances)[0].max())
    if grid is not None:
        facts["grid"] = _grid_facts(grid)
    for key in ("plan", "particles", "diagnosis"):
        value = store.get(key)
        if value is not None:
            facts[key] = value
    return facts


def _grid_facts(grid: OccupancyGrid) -> dict[str, Any]:
    from mapmyworld.evaluation.sharpness import grid_sharpness

    cells = grid.trinary()
    return {
        "resolution_m": grid.resolution,
        "width": int(cells.shape[1]),
        "height": int(cells.shape[0]),
        "free_m2": grid.area_m2(0),
        "occupied_m2": grid.area_m2(100),
        "unknown_share": float((cells == -1).mean()),
        "mean_entropy_bits": grid_sharpness(grid).entropy_bits,
    }


def _lines(facts: dict[str, Any]) -> list[str]:
    lines = [
        f"sessions:   {facts['sessions']}",
        f"nodes:      {facts['nodes']} from {facts['frames']} frames",
        f"duration:   {facts['duration_s']:.1f} s",
    ]
    if not facts["solved"]:
        lines.append("solved:     no: the build did not get that far; build it again to go on")
    if "length_m" in facts:
        lines.append(f"length:     {facts['length_m']:.1f} m")
        closures = facts["closures"]
        lines.append(f"closures:   {closures['accepted']} accepted of {closures['tried']} tried")
    if facts.get("components", 1) > 1:
        lines.append(f"components: {facts['components']}, with unknown relative pose")
    if "largest_sigma_m" in facts:
        lines.append(f"sigma:      {facts['largest_sigma_m']:.3f} m at the worst node")
    grid = facts.get("grid")
    if grid:
        lines += [
            f"grid:       {grid['width']} x {grid['height']} cells of {grid['resolution_m']} m",
            f"area:       {grid['free_m2']:.1f} m2 free, {grid['occupied_m2']:.1f} m2 occupied",
        ]
        if grid["mean_entropy_bits"] is not None:
            reported = f"{grid['mean_entropy_bits']:.3f} bits mean entropy of seen cells"
            lines.append(f"sharpness:  {reported}")
    if "particles" in facts:
        lines.append("particles:")
        lines += [
            f"  {name}: {value}"
            for name, value in facts["particles"].items()
            if not isinstance(value, list | dict)
        ]
    decisions = (facts.get("plan") or {}).get("decisions")
    if decisions:  # a map of a graph was made of no log
        lines.append("made from:")
        lines += [f"  {d['role']}: {d['choice'] or 'none'}" for d in decisions]
    return lines + _diagnosis_lines(facts.get("diagnosis") or ())


def _diagnosis_lines(findings: Sequence[Mapping[str, Any]]) -> list[str]:
    """What is not as it should be, with what to do."""
    bad = [found for found in findings if not found["good"]]
    lines = [f"diagnosis:  {len(findings)} comparisons of sensors, {len(bad)} to look at"]
    lines += [f"  {found['text']}; {found['suggestion']}" for found in bad]
    return lines if findings else []
