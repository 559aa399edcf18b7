"""A picture of particle paths: all that were tried, and the one that explained the scans best."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from formats.report.grid_canvas import canvas_from_grid
from formats.report.match_picture import Picture, with_caption
from mapmyworld.types import OccupancyGrid

_BRANCH = (240, 150, 60)  # RGB: particles
_BEST = (30, 90, 200)  # the best particle
_LOOP = (0, 150, 70)  # where it came back to known places


def particle_picture(
    grid: OccupancyGrid,
    branches: NDArray[np.floating],
    path: NDArray[np.floating],
    loops: NDArray[np.floating],
    side: int = 1000,
) -> Picture:
    """The grid (H, W, 3) RGB under all particles' paths `branches` (S, 2, 2) and the best `path`.

    `path` (K, 2) and the places `loops` (L, 2) at which it came back; all in the map, metres.
    """
    canvas = canvas_from_grid(grid, side)
    if len(branches):
        canvas.draw_lines(branches, _BRANCH)
    if len(path) > 1:
        canvas.draw_lines(np.asarray(path)[None], _BEST)
    if len(loops):
        canvas.draw_rings(loops, _LOOP)
    caption = f"{len(path)} updates; orange: all particles, blue: the best one"
    caption += f", green: {len(loops)} returns to known places" if len(loops) else ""
    return with_caption(canvas.pixels, caption)
