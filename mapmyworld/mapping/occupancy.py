"""The occupancy grid of scans whose poses are known (Probabilistic Robotics, table 9.1)."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from contextlib import closing
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mapmyworld.config import Config, MappingConfig
from mapmyworld.errors import MapError
from mapmyworld.kernels.rays import count_scans
from mapmyworld.parallel import batches, made_ahead
from mapmyworld.types import OccupancyGrid, Scan

Array = NDArray[np.float64]
_MARGIN = 64  # cells by which the canvas outgrows what is needed, so that it seldom grows
_TOGETHER = 128  # scans that are drawn in one go
_AHEAD = 2  # such groups that wait to be drawn, at most
_MOST_CELLS = 400_000_000  # of the canvas; beyond, some range or pose is nonsense


def build_grid(scans: Iterable[tuple[Array, Scan]], config: Config) -> OccupancyGrid:
    """The grid of scans at map_from_base poses (3,); raises `MapError` where there is nothing.

    A cell's log-odds are the sum of the inverse sensor model over the scans that saw it, clamped.
    A scan sees a cell once, as occupied if one of its beams ended there; so the result does not
    depend on the order of the scans.
    """
    settings = config.mapping
    canvas = _Canvas(settings.resolution)
    rays = (_rays(some, settings) for some in batches(scans, _TOGETHER))
    with closing(made_ahead(rays, _AHEAD)) as ready:
        for some in ready:
            canvas.add(some)
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

    def add(self, rays: _Rays) -> None:
        if not len(rays.ends):
            return
        ends, starts = rays.ends, rays.starts
        used = starts[np.diff(rays.bounds) > 0]
        low = np.floor(np.minimum(ends.min(axis=0), used.min(axis=0))).astype(np.int64)
        high = np.floor(np.maximum(ends.max(axis=0), used.max(axis=0))).astype(np.int64)
        self._cover(low, high)
        count_scans(
            self._hits, self._passes, self._marks, self._mark,
            starts - self._corner, ends - self._corner, rays.is_hit, rays.bounds,
        )  # fmt: skip
        self._mark += len(starts)

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


@dataclass(frozen=True, slots=True, eq=False)
class _Rays:
    """The beams of some scans in the map, in cells."""

    starts: Array
    """(S, 2) the lidars."""
    ends: Array
    """(R, 2) where the beams end."""
    is_hit: NDArray[np.bool_]
    """(R,) whether something stopped them there."""
    bounds: NDArray[np.int64]
    """(S + 1,) where each scan's beams begin."""


def _rays(scans: Sequence[tuple[Array, Scan]], settings: MappingConfig) -> _Rays:
    """Beams up to the range of the map; a scan whose pose is not finite has none."""
    poses = np.array([pose for pose, _ in scans], np.float64)
    origins = np.array([scan.origin[:2] for _, scan in scans], np.float64)
    starts = _placed(poses, origins)
    points = np.concatenate([scan.points for _, scan in scans]).astype(np.float64)
    scan_of = np.repeat(np.arange(len(scans)), [len(scan.points) for _, scan in scans])
    beams = _placed(poses[scan_of], points) - starts[scan_of]
    lengths = np.maximum(np.hypot(beams[:, 0], beams[:, 1]), 1e-9)
    is_hit = lengths <= settings.range_max
    ends = starts[scan_of] + beams * np.minimum(1.0, settings.range_max / lengths)[:, None]
    if settings.missing_range > 0:
        away, of = _missing_ends(scans, poses, starts, settings)
        ends, scan_of = np.concatenate([ends, away]), np.concatenate([scan_of, of])
        is_hit = np.concatenate([is_hit, np.zeros(len(away), np.bool_)])
        order = np.argsort(scan_of, kind="stable")
        ends, is_hit, scan_of = ends[order], is_hit[order], scan_of[order]
    finite = np.isfinite(ends).all(axis=1) & np.isfinite(starts[scan_of]).all(axis=1)
    bounds = np.searchsorted(scan_of[finite], np.arange(len(scans) + 1))
    ends = ends[finite] / settings.resolution
    return _Rays(starts / settings.resolution, ends, is_hit[finite], bounds)


def _missing_ends(
    scans: Sequence[tuple[Array, Scan]], poses: Array, starts: Array, settings: MappingConfig
) -> tuple[Array, NDArray[np.int64]]:
    """How far beams without a return are taken to have gone (R, 2), and of which scan they are."""
    scan_of = np.repeat(np.arange(len(scans)), [len(scan.missing) for _, scan in scans])
    bearings = np.concatenate([scan.missing for _, scan in scans]) + poses[scan_of, 2]
    reach = np.array([min(settings.missing_range, scan.range_max) for _, scan in scans])[scan_of]
    away = reach[:, None] * np.stack([np.cos(bearings), np.sin(bearings)], axis=-1)
    return starts[scan_of] + away, scan_of


def _placed(poses: Array, points: Array) -> Array:
    """Points (N, 2), each in a base at its own pose (N, 3), in the map."""
    c, s = np.cos(poses[:, 2]), np.sin(poses[:, 2])
    x = c * points[:, 0] - s * points[:, 1] + poses[:, 0]
    return np.stack([x, s * points[:, 0] + c * points[:, 1] + poses[:, 1]], axis=-1)
