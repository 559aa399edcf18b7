"""A picture of particle paths: all that were tried, and the one that explained the scans best."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from formats.report.map_axes import (
    WIDTH,
    draw_lines,
    draw_rings,
    figure_file,
    legend,
    plan_axes,
)
from mapmyworld.types import OccupancyGrid

_BRANCH, _BEST, _LOOP = "#f0963c", "#1e5ac8", "#009646"


def write_particle_picture(
    path: Path,
    grid: OccupancyGrid,
    branches: NDArray[np.floating],
    best: NDArray[np.floating],
    loops: NDArray[np.floating],
) -> None:
    """The grid under all particles' paths `branches` (S, 2, 2) and the best one, `best` (K, 2).

    `loops` (L, 2) are the places at which it came back; all in the map, metres.
    """
    with figure_file(path, WIDTH) as figure:
        axes = plan_axes(figure, grid, best)
        draw_lines(axes, branches, _BRANCH, "all particles", 0.6)
        steps = np.stack([best[:-1], best[1:]], axis=1)
        draw_lines(axes, steps, _BEST, f"the best one, {len(best)} updates", 0.8)
        draw_rings(axes, loops, _LOOP, f"{len(loops)} returns to known places")
        legend(axes)
