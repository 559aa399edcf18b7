"""The occupancy grid of scans whose poses are known (Probabilistic Robotics, table 9.1)."""

from __future__ import annotations

import os
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from queue import SimpleQueue
from threading import Lock

import numpy as np
from numpy.typing import NDArray

from mapmyworld.config import Config, MappingConfig
from mapmyworld.errors import MapError
from mapmyworld.kernels.rays import count_scans
from mapmyworld.parallel import batches, in_threads
from mapmyworld.types import OccupancyGrid, Scan

Array = NDArray[np.float64]
_MARGIN = 64  # cells by which the canvas outgrows what is needed, so that it seldom grows
_TOGETHER = 128  # scans that are drawn in one go
_MOST_MARKS = 255  # scans that a cell's mark tells apart
_MOST_COUNTED = 65535  # scans that a cell counts
_CANVASES = 2  # drawn on at the same time, at most: they take memory, and share its bandwidth
_LARGE = 4_000_000  # cells from which one canvas is drawn on and no other, to save memory
_MOST_CELLS = 400_000_000  # of the canvas; beyond, some range or pose is nonsense


def build_grid(scans: Iterable[tuple[Array, Scan]], config: Config) -> OccupancyGrid:
    """The grid of scans at map_from_base poses (3,); raises `MapError` where there is nothing.

    A cell's log-odds are the sum of the inverse sensor model over the scans that saw it, clamped.
    A scan sees a cell once, as occupied if one of its beams ended there; so the result does not
    depend on the order of the scans.
    """
    count = min(config.threads or os.cpu_count() or 1, _CANVASES)
    return _grid_of(_together(_drawn(scans, config.mapping, count)), config.mapping)


def _drawn(
    scans: Iterable[tuple[Array, Scan]], settings: MappingConfig, count: int
) -> list[_Counts]:
    """What is counted on each of `count` canvases: which scan comes on which changes nothing."""
    free: SimpleQueue[_Canvas] = SimpleQueue()
    for _ in range(count):
        free.put(_Canvas())
    kept: list[_Counts | None] = []
    deciding = Lock()

    def give_back(canvas: _Canvas) -> None:
        with deciding:
            if canvas.area < _LARGE or len(kept) == count - 1:
                free.put(canvas)
            else:
                kept.append(canvas.seen())  # of a large building one canvas is enough to hold

    def draw(some: Sequence[tuple[Array, Scan]]) -> None:
        canvas = free.get()
        try:
            canvas.add(_rays(some, settings))
        finally:
            give_back(canvas)

    for _ in in_threads(draw, batches(scans, _TOGETHER), count):
        pass
    kept += [free.get_nowait().seen() for _ in range(count - len(kept))]
    return [part for part in kept if part is not None]


class _Canvas:
    """Counts of hits and passes on a lattice through the map's origin; grows as scans come."""

    def __init__(self) -> None:
        self._corner = np.zeros(2, np.int64)  # lattice cell of the canvas's cell (0, 0)
        self._hits = np.zeros((0, 0), np.uint16)
        self._passes = np.zeros((0, 0), np.uint16)
        self._marks = np.zeros((0, 0), np.uint8)
        self._mark = 0
        self._used = np.zeros((2, 2), np.int64)  # lattice cells, first and one beyond the last

    @property
    def area(self) -> int:
        """Cells that were held at once, about."""
        return int(np.prod(self._used[1] - self._used[0]))

    def add(self, rays: _Rays) -> None:
        if not len(rays.ends):
            return
        ends, starts = rays.ends, rays.starts
        used = starts[np.diff(rays.bounds) > 0]
        low = np.floor(np.minimum(ends.min(axis=0), used.min(axis=0))).astype(np.int64)
        high = np.floor(np.maximum(ends.max(axis=0), used.max(axis=0))).astype(np.int64)
        self._cover(low, high)
        if self._mark + len(starts) > _MOST_MARKS:
            self._marks, self._mark = np.zeros_like(self._marks), 0
        count_scans(
            self._hits, self._passes, self._marks, self._mark,
            starts - self._corner, ends - self._corner, rays.is_hit, rays.bounds,
        )  # fmt: skip
        self._mark += len(starts)

    def _cover(self, low: NDArray[np.int64], high: NDArray[np.int64]) -> None:
        """Grows the canvas until it holds the lattice cells `low` to `high`."""
        size = np.array(self._hits.shape[::-1], np.int64)
        if size.all() and (low >= self._corner).all() and (high < self._corner + size).all():
            self._use(low, high)
            return
        margin = _MARGIN + size // 4
        corner, top = low - _MARGIN, high + _MARGIN + 1
        if size.all():
            old_top = self._corner + size
            corner = np.where(low < self._corner, low - margin, self._corner)
            top = np.where(high >= old_top, high + margin + 1, old_top)
        width, height = _checked_size(top - corner)
        (x0, y0), (x1, y1) = (self._used - corner).tolist()
        old = self._used - self._corner
        for name in ("_hits", "_passes", "_marks"):
            held = getattr(self, name)
            grown = np.zeros((height, width), held.dtype)
            if size.all():  # what nothing was drawn on takes no memory, and is left so
                grown[y0:y1, x0:x1] = held[old[0, 1] : old[1, 1], old[0, 0] : old[1, 0]]
            setattr(self, name, grown)
        self._corner = corner
        self._use(low, high)

    def _use(self, low: NDArray[np.int64], high: NDArray[np.int64]) -> None:
        if self.area:
            low, high = np.minimum(low, self._used[0]), np.maximum(high, self._used[1] - 1)
        self._used = np.array([low, high + 1])

    def seen(self) -> _Counts | None:
        """The part that was seen; None for nothing."""
        rows, columns = (
            np.flatnonzero(self._hits.any(axis=axis) | self._passes.any(axis=axis))
            for axis in (1, 0)
        )
        if not len(rows):
            return None
        part = np.s_[rows[0] : rows[-1] + 1, columns[0] : columns[-1] + 1]
        corner = self._corner + np.array([columns[0], rows[0]])
        return _Counts(corner, self._hits[part], self._passes[part])


@dataclass(frozen=True, slots=True, eq=False)
class _Counts:
    """Of each cell, how many scans ended in it and how many passed."""

    corner: NDArray[np.int64]
    """(2,) lattice cell of the first one."""
    hits: NDArray[np.uint16]
    """(H, W)."""
    passes: NDArray[np.uint16]
    """(H, W)."""


def _together(parts: list[_Counts]) -> _Counts:
    """The counts of all parts, one cell of margin around; they are taken out of the list, so that
    of a large building no more is held than must be.
    """
    if not parts:
        raise MapError("no scan has a return in range: there is nothing to draw a grid of")
    corner = np.min([part.corner for part in parts], axis=0) - 1
    tops = [part.corner + part.hits.shape[::-1] for part in parts]
    width, height = _checked_size(np.max(tops, axis=0) + 1 - corner)
    hits, passes = np.zeros((height, width), np.uint16), np.zeros((height, width), np.uint16)
    while parts:
        part = parts.pop()
        x, y = (part.corner - corner).tolist()
        for row in range(part.hits.shape[0]):
            place = np.s_[y + row, x : x + part.hits.shape[1]]
            for sums, more in ((hits[place], part.hits[row]), (passes[place], part.passes[row])):
                sums += np.minimum(more, _MOST_COUNTED - sums)
    return _Counts(corner, hits, passes)


def _checked_size(size: NDArray[np.int64]) -> tuple[int, int]:
    """Width and height of a canvas, unless they are nonsense."""
    width, height = size.tolist()
    if width * height > _MOST_CELLS:
        raise MapError(
            f"the grid would be {width} x {height} cells: raise mapping.resolution or lower "
            "mapping.range_max"
        )
    return width, height


def _grid_of(counts: _Counts, settings: MappingConfig) -> OccupancyGrid:
    log_odds = log_odds_of(counts.hits, counts.passes, settings)
    origin = np.round(counts.corner * settings.resolution, 9)
    return OccupancyGrid(log_odds, settings.resolution, origin)


def log_odds_of(
    hits: NDArray[np.uint16], passes: NDArray[np.uint16], settings: MappingConfig
) -> NDArray[np.float32]:
    """Log-odds (H, W) after so many hits and passes; NaN where there were neither.

    l = sum of (inverse_sensor_model - l0) with l0 = 0, table 9.1, clamped at the end.
    """
    occupied = np.float32(_log_odds(settings.hit_probability))
    free = np.float32(_log_odds(settings.miss_probability))
    limit = np.float32(_log_odds(settings.clamp_probability))
    log_odds = np.empty(hits.shape, np.float32)
    for row, hit, passed in zip(log_odds, hits, passes, strict=True):
        row[:] = hit * occupied
        row += passed * free
        np.clip(row, -limit, limit, out=row)
        row[(hit == 0) & (passed == 0)] = np.nan
    return log_odds


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
