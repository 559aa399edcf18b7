"""The beams of scans in cells, and the canvas on which they are drawn."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mapmyworld.config import MappingConfig
from mapmyworld.errors import MapError, NothingToDrawError
from mapmyworld.geometry import Array
from mapmyworld.kernels.rays import count_scans
from mapmyworld.types import Scan

_MARGIN = 64  # cells by which the canvas outgrows what is needed, so that it seldom grows
_MOST_CELLS = 400_000_000  # of the canvas; beyond, some range or pose is nonsense


@dataclass(frozen=True, slots=True, eq=False)
class Beams:
    """The beams of some scans in the map, in cells."""

    starts: Array
    """(S, 2) the lidars."""
    ends: Array
    """(R, 2) where the beams end."""
    is_hit: NDArray[np.bool_]
    """(R,) whether something stopped them there."""
    bounds: NDArray[np.int64]
    """(S + 1,) where each scan's beams begin."""


def beams_of(scans: Sequence[tuple[Array, Scan]], settings: MappingConfig) -> Beams:
    """Beams of scans at poses (3,), map_from_base, up to the range of the map.

    A scan whose pose is not finite has none.
    """
    poses = np.array([pose for pose, _ in scans], np.float64)
    origins = np.array([scan.origin[:2] for _, scan in scans], np.float64)
    starts = _placed(poses, origins)
    points, returned = _joined([scan.points for _, scan in scans])
    beams = _placed(poses[returned], points) - starts[returned]
    lengths = np.maximum(np.hypot(beams[:, 0], beams[:, 1]), 1e-9)
    shares = np.minimum(1.0, settings.range_max / lengths)
    stopped = starts[returned] + beams * shares[:, None]
    # Beams without a return are taken to have gone so far, unless they are not drawn at all.
    drawn = slice(None if settings.missing_range > 0 else 0)
    bearings, empty = _joined([scan.missing[drawn] for _, scan in scans])
    bearings = bearings + poses[empty, 2]
    reach = np.array([min(settings.missing_range, scan.range_max) for _, scan in scans])[empty]
    away = reach[:, None] * np.stack([np.cos(bearings), np.sin(bearings)], axis=-1)
    passed, passing = _joined([scan.passed for _, scan in scans])
    scan_of = np.concatenate([returned, empty, passing])
    order = np.argsort(scan_of, kind="stable")
    ends = np.concatenate([stopped, starts[empty] + away, _placed(poses[passing], passed)])[order]
    is_hit = np.pad(lengths <= settings.range_max, (0, len(empty) + len(passing)))[order]
    scan_of = scan_of[order]
    finite = np.isfinite(ends).all(axis=1) & np.isfinite(starts[scan_of]).all(axis=1)
    bounds = np.searchsorted(scan_of[finite], np.arange(len(scans) + 1))
    ends = ends[finite] / settings.resolution
    return Beams(starts / settings.resolution, ends, is_hit[finite], bounds)


def _joined(parts: Sequence[NDArray[np.float32]]) -> tuple[Array, NDArray[np.int64]]:
    """All rows of some arrays, and in which of them each stood."""
    which = np.repeat(np.arange(len(parts)), [len(part) for part in parts])
    return np.concatenate(parts).astype(np.float64), which


def _placed(poses: Array, points: Array) -> Array:
    """Points (N, 2), each in a base at its own pose (N, 3), in the map."""
    c, s = np.cos(poses[:, 2]), np.sin(poses[:, 2])
    x = c * points[:, 0] - s * points[:, 1] + poses[:, 0]
    return np.stack([x, s * points[:, 0] + c * points[:, 1] + poses[:, 1]], axis=-1)


class Canvas:
    """Counts of hits and passes on a lattice through the map's origin; grows as scans come.

    It begins with all that scans at `places` (N, 2) may reach, both in cells: to grow takes the
    memory of two, and what is not drawn on takes little.
    """

    def __init__(self, places: Array, reach: float) -> None:
        self._corner = np.zeros(2, np.int64)  # lattice cell of the canvas's cell (0, 0)
        self._cells = np.zeros((0, 0, 2), np.uint16)  # hits and passes
        places = places[np.isfinite(places).all(axis=1)]
        low = places.min(axis=0, initial=np.inf) - reach - _MARGIN
        high = places.max(axis=0, initial=-np.inf) + reach + _MARGIN
        if 0.0 < np.prod(high - low) <= _MOST_CELLS:
            self._cover(np.floor(low).astype(np.int64), np.floor(high).astype(np.int64))

    def add(self, beams: Beams) -> None:
        """Draws the beams of at most 255 scans."""
        if not len(beams.ends):
            return
        ends, starts = beams.ends, beams.starts
        used = starts[np.diff(beams.bounds) > 0]
        low = np.floor(np.minimum(ends.min(axis=0), used.min(axis=0))).astype(np.int64)
        high = np.floor(np.maximum(ends.max(axis=0), used.max(axis=0))).astype(np.int64)
        self._cover(low - 1, high + 1)  # with a cell of margin around
        count_scans(
            self._cells, np.zeros(self._cells.shape[:2], np.uint8),
            starts - self._corner, ends - self._corner, beams.is_hit, beams.bounds,
        )  # fmt: skip

    def _cover(self, low: NDArray[np.int64], high: NDArray[np.int64]) -> None:
        """Grows the canvas until it holds the lattice cells `low` to `high`."""
        size = np.array(self._cells.shape[1::-1], np.int64)
        if not size.all():
            self._corner = low
        lacks = np.maximum(self._corner - low, 0), np.maximum(high + 1 - self._corner - size, 0)
        if not np.any(lacks):
            return
        margin = _MARGIN + size // 4
        left, right = (np.where(lack > 0, lack + margin, 0) for lack in lacks)
        before, size = size, left + size + right
        width, height = size.tolist()
        if width * height > _MOST_CELLS:  # of nonsense
            raise MapError(
                f"the grid would be {width} x {height} cells: raise mapping.resolution or lower "
                "mapping.range_max"
            )
        wider = np.zeros((*size[::-1], 2), np.uint16)
        part = tuple(slice(a, a + n) for a, n in zip(left[::-1], before[::-1], strict=True))
        wider[part] = self._cells
        self._corner, self._cells = self._corner - left, wider

    def seen(self) -> tuple[NDArray[np.int64], NDArray[np.uint16]]:
        """The part that was seen, one cell of margin around: the lattice cell (2,) of its first
        one, and hits and passes (H, W, 2), a part of what was drawn on.

        Raises `NothingToDrawError` where nothing was.
        """
        pairs = self._cells.view(np.uint32)[:, :, 0]
        rows, columns = (np.flatnonzero(pairs.any(axis=axis)) for axis in (1, 0))
        if not len(rows):
            raise NothingToDrawError(
                "no scan has a return in range: there is nothing to draw a grid of"
            )
        part = np.s_[rows[0] - 1 : rows[-1] + 2, columns[0] - 1 : columns[-1] + 2]
        corner = self._corner + np.array([columns[0], rows[0]]) - 1
        return corner, self._cells[part]
