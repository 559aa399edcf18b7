"""The head of the report: what came of it, in figures, and the files that hold it."""

from __future__ import annotations

import os
from collections.abc import Sequence
from datetime import UTC, datetime
from pathlib import Path

from mapmyworld.map_figures import MapFigures
from mapmyworld.types import OccupancyGrid

_DATES_NS = 631_152_000 * 10**9, 4_102_444_800 * 10**9  # from 1990 to 2100
_PRODUCTS = {
    ".pgm": "the grid's picture",
    ".yaml": "the grid, for Nav2",
    ".ply": "the cloud",
    ".tum": "the trajectory",
}


def headline(figures: MapFigures, grid: OccupancyGrid | None) -> list[tuple[str, str]]:
    """Name and value of each figure."""
    closures, count, date = figures.closures, len(figures.components), _date(figures.begun_ns)
    return [
        *([("recorded", date)] if date else []),
        ("path", f"{figures.path_m:.1f} m"),
        ("time", f"{figures.duration_s:.0f} s"),
        *(_grid_headline(grid) if grid is not None else ()),
        ("nodes", f"{figures.nodes:,}"),
        ("tracked frames", f"{figures.frames:,}"),
        ("sessions", f"{figures.sessions}"),
        ("closures", f"{closures['accepted']:,} accepted of {closures['tried']:,} tried"),
        *([("components", f"{count}")] if count > 1 else []),
    ]


def _grid_headline(grid: OccupancyGrid) -> list[tuple[str, str]]:
    height, width = (cells * grid.resolution for cells in grid.log_odds.shape)
    return [
        ("free area", f"{grid.area_m2(0):.1f} m²"),
        ("size", f"{width:.1f} m x {height:.1f} m"),
        ("resolution", f"{grid.resolution:g} m"),
    ]


def _date(stamp_ns: int | None) -> str:
    """When it was recorded; empty where the clock knew no date, as a simulation's does not."""
    if stamp_ns is None or not _DATES_NS[0] < stamp_ns < _DATES_NS[1]:
        return ""
    moment = datetime.fromtimestamp(stamp_ns // 10**9, UTC)
    return moment.strftime("%Y-%m-%d %H:%M UTC")


def products(map_path: Path, folder: Path | None) -> list[tuple[str, str]]:
    """Relative path and meaning of each file beside the map that is there."""
    found = [(map_path.with_suffix(ending), what) for ending, what in _PRODUCTS.items()]
    start = map_path.parent if folder is None else folder
    return [
        (Path(os.path.relpath(path, start)).as_posix(), what)
        for path, what in [(map_path, "everything, for every command"), *found]
        if path.is_file()
    ]


def verdict(figures: MapFigures, problems: Sequence[str]) -> str:
    """Whole or partial, and what ties it together; whether it is the best comes last of all."""
    state = "A whole map"
    if problems:
        state = f"A partial map: {len(problems)} problem{'s' * (len(problems) > 1)}"
    closures, count = figures.closures["accepted"], len(figures.components)
    tied = f"{closures:,} closure{'s' * (closures != 1)} tie{'s' * (closures == 1)} it together"
    tied = tied if closures else "No place was recognised again: drift stays in it"
    parts = f", in {count} components with unknown relative pose" if count > 1 else ""
    return f"{state}. {tied}{parts}."
