"""A grid of more scans added to a grid that was there."""

from __future__ import annotations

import numpy as np

from mapmyworld.config import Config
from mapmyworld.types import OccupancyGrid


def added_grid(known: OccupancyGrid, more: OccupancyGrid, config: Config) -> OccupancyGrid | None:
    """The sum of the log-odds of both, clamped; None where their cells do not coincide."""
    shift = (more.origin - known.origin) / known.resolution
    offset = np.round(shift).astype(np.int64)
    if more.resolution != known.resolution or np.abs(shift - offset).max() > 1e-3:
        return None
    low = np.minimum(offset, 0)
    sizes = [np.array(grid.log_odds.shape[::-1]) for grid in (known, more)]
    width, height = np.maximum(sizes[0], offset + sizes[1]) - low
    total = np.full((height, width), np.nan, np.float32)
    for grid, corner in ((known, -low), (more, offset - low)):
        rows, columns = grid.log_odds.shape
        part = total[corner[1] : corner[1] + rows, corner[0] : corner[0] + columns]
        part[...] = np.where(np.isnan(part), grid.log_odds, part + np.nan_to_num(grid.log_odds))
    clamp = config.mapping.clamp_probability
    limit = np.float32(np.log(clamp / (1.0 - clamp)))
    origin = np.round(known.origin + low * known.resolution, 9)
    return OccupancyGrid(
        np.clip(total, -limit, limit), known.resolution, origin,
        known.occupied_threshold, known.free_threshold,
    )  # fmt: skip
