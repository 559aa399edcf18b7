"""The occupancy grid of scans whose poses are known (Probabilistic Robotics, table 9.1)."""

from __future__ import annotations

from collections.abc import Iterable
from functools import partial

import numpy as np
from numpy.typing import NDArray

from mapmyworld.config import Config, MappingConfig
from mapmyworld.geometry import Array
from mapmyworld.mapping.canvas import Canvas, beams_of
from mapmyworld.parallel import batches, in_threads
from mapmyworld.types import OccupancyGrid, Scan

_TOGETHER = 128  # scans that are drawn in one go


def build_grid(
    scans: Iterable[tuple[Array, Scan]], config: Config, places: Array | None = None
) -> OccupancyGrid:
    """The grid of scans at map_from_base poses (3,); `NothingToDrawError` where none has a return.

    It takes less memory where the `places` (N, 2) of most scans, m, are known beforehand.

    A cell's log-odds are the sum of the inverse sensor model over the scans that saw it, clamped.
    A scan sees a cell once, as occupied if one of its beams ended there; so the result does not
    depend on the order of the scans.
    """
    settings = config.mapping
    places = np.zeros((0, 2)) if places is None else places
    canvas = Canvas(places / settings.resolution, settings.range_max / settings.resolution)
    placed = partial(beams_of, settings=settings)
    for beams in in_threads(placed, batches(scans, _TOGETHER), threads=1):
        canvas.add(beams)
    corner, cells = canvas.seen()
    log_odds = log_odds_in_place(cells, settings)
    origin = np.round(corner * settings.resolution, 9)
    return OccupancyGrid(log_odds, settings.resolution, origin)


def log_odds_in_place(cells: NDArray[np.uint16], settings: MappingConfig) -> NDArray[np.float32]:
    """Log-odds (H, W) after so many hits and passes, `cells` (H, W, 2), in whose memory they are
    written; NaN where there were neither.

    l = sum of (inverse_sensor_model - l0) with l0 = 0, table 9.1, clamped at the end.
    """
    occupied = np.float32(_log_odds(settings.hit_probability))
    free = np.float32(_log_odds(settings.miss_probability))
    limit = np.float32(_log_odds(settings.clamp_probability))
    log_odds = cells.view(np.float32)[:, :, 0]
    for row, (hits, passes) in zip(log_odds, cells.swapaxes(1, 2), strict=True):
        odds = hits * occupied
        odds += passes * free
        np.clip(odds, -limit, limit, out=odds)
        odds[(hits == 0) & (passes == 0)] = np.nan
        row[:] = odds
    return log_odds


def _log_odds(probability: float) -> float:
    return float(np.log(probability / (1.0 - probability)))


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
    limit = np.float32(_log_odds(config.mapping.clamp_probability))
    origin = np.round(known.origin + low * known.resolution, 9)
    return OccupancyGrid(np.clip(total, -limit, limit), known.resolution, origin)
