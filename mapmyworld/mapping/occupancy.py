"""The occupancy grid of scans whose poses are known (Probabilistic Robotics, table 9.1)."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np
from numpy.typing import NDArray

from mapmyworld.config import Config, MappingConfig
from mapmyworld.errors import MapError
from mapmyworld.geometry import transform_points_planar
from mapmyworld.kernels.rays import count_rays
from mapmyworld.types import OccupancyGrid, Scan

Array = NDArray[np.float64]
_MARGIN = 64  # cells by which the canvas outgrows what is needed, so that it seldom grows
_MOST_CELLS = 400_000_000  # of the canvas; beyond, some range or pose is nonsense


def build_grid(scans: Iterable[tuple[Array, Scan]], config: Config) -> OccupancyGrid:
    """The grid of scans at map_from_base poses (3,); raises `MapError` where there is nothing.

    A cell's log-odds are the sum of the inverse sensor model over the scans that saw it, clamped.
    A scan sees a cell once, as occupied if one of its beams ended there; so the result does not
    depend on the order of the scans.
    """
    settings = config.mapping
    canvas = _Canvas(settings.resolution)
    for map_from_base, scan in scans:
        canvas.add(map_from_base, scan, settings)
    return canvas.finish(settings)


class _Canvas:
    """Counts of hits and passes on a lattice through the map's origin; grows as scans come."""

    def __init__(self, resolution: float) -> None:
        self._resolution = resolution
        self._corner = np.zeros(2, np.int64)  # lattice cell of the canvas's cell (0, 0)
        self._hits = np.zeros((0, 0), np.uint16)
        self._passes = np.zeros((0, 0), np.uint16)
        self._marks = np.zeros((0, 0), np.int32)
        self._mark = 0

    def add(self, map_from_base: Array, scan: Scan, settings: MappingConfig) -> None:
        lidar = transform_points_planar(map_from_base, scan.origin[None, :2])[0]
        ends, is_hit = _rays(map_from_base, lidar, scan, settings)
        if not len(ends) or not np.isfinite(lidar).all():
            return
        cells = ends / self._resolution
        start = lidar / self._resolution
        low = np.floor(np.minimum(cells.min(axis=0), start)).astype(np.int64)
        high = np.floor(np.maximum(cells.max(axis=0), start)).astype(np.int64)
        self._cover(low, high)
        self._mark += 1
        inside = np.ascontiguousarray(cells - self._corner)
        x0, y0 = (start - self._corner).tolist()
        count_rays(self._hits, self._passes, self._marks, self._mark, x0, y0, inside, is_hit)

    def _cover(self, low: NDArray[np.int64], high: NDArray[np.int64]) -> None:
        """Grows the canvas until it holds the lattice cells `low` to `high`."""
        size = np.array(self._hits.shape[::-1], np.int64)
        if size.all() and (low >= self._corner).all() and (high < self._corner + size).all():
            return
        margin = _MARGIN + size // 4
        corner, top = low - _MARGIN, high + _MARGIN + 1
        if size.all():
            old_top = self._corner + size
            corner = np.where(low < self._corner, low - margin, self._corner)
            top = np.where(high >= old_top, high + margin + 1, old_top)
        width, height = (top - corner).tolist()
        if width * height > _MOST_CELLS:
            raise MapError(
                f"the grid would be {width} x {height} cells: raise mapping.resolution or lower "
                "mapping.range_max"
            )
        x, y = (self._corner - corner).tolist()
        place = np.s_[y : y + size[1], x : x + size[0]]
        for name in ("_hits", "_passes", "_marks"):
            old = getattr(self, name)
            grown = np.zeros((height, width), old.dtype)
            if size.all():
                grown[place] = old
            setattr(self, name, grown)
        self._corner = corner

    def finish(self, settings: MappingConfig) -> OccupancyGrid:
        """The log-odds of the part that was seen, one cell of margin around."""
        seen = (self._hits > 0) | (self._passes > 0)
        if not seen.any():
            raise MapError("no scan has a return in range: there is nothing to draw a grid of")
        rows, columns = np.flatnonzero(seen.any(axis=1)), np.flatnonzero(seen.any(axis=0))
        part = np.s_[
            max(rows[0] - 1, 0) : rows[-1] + 2,
            max(columns[0] - 1, 0) : columns[-1] + 2,
        ]
        log_odds = log_odds_of(self._hits[part], self._passes[part], settings)
        corner = self._corner + np.array([max(columns[0] - 1, 0), max(rows[0] - 1, 0)])
        return OccupancyGrid(log_odds, self._resolution, np.round(corner * self._resolution, 9))


def log_odds_of(
    hits: NDArray[np.uint16], passes: NDArray[np.uint16], settings: MappingConfig
) -> NDArray[np.float32]:
    """Log-odds (H, W) after so many hits and passes; NaN where there were neither.

    l = sum of (inverse_sensor_model - l0) with l0 = 0, table 9.1, clamped at the end.
    """
    occupied = np.float32(_log_odds(settings.hit_probability))
    free = np.float32(_log_odds(settings.miss_probability))
    log_odds = hits * occupied + passes * free
    limit = np.float32(_log_odds(settings.clamp_probability))
    log_odds = np.clip(log_odds, -limit, limit).astype(np.float32)
    log_odds[(hits == 0) & (passes == 0)] = np.nan
    return np.asarray(log_odds, np.float32)


def _log_odds(probability: float) -> float:
    return float(np.log(probability / (1.0 - probability)))


def _rays(
    map_from_base: Array, lidar: Array, scan: Scan, settings: MappingConfig
) -> tuple[Array, NDArray[np.bool_]]:
    """Ends (N, 2) of the beams in the map, and whether something stopped them there."""
    points = transform_points_planar(map_from_base, scan.points)
    beams = points - lidar
    lengths = np.maximum(np.hypot(beams[:, 0], beams[:, 1]), 1e-9)
    is_hit = lengths <= settings.range_max
    ends = lidar + beams * np.minimum(1.0, settings.range_max / lengths)[:, None]
    if settings.missing_range > 0 and len(scan.missing):
        bearings = scan.missing.astype(np.float64) + map_from_base[2]
        reach = min(settings.missing_range, scan.range_max)
        away = lidar + reach * np.stack([np.cos(bearings), np.sin(bearings)], axis=-1)
        ends = np.concatenate([ends, away])
        is_hit = np.concatenate([is_hit, np.zeros(len(away), np.bool_)])
    finite = np.isfinite(ends).all(axis=1)
    return ends[finite], is_hit[finite]
