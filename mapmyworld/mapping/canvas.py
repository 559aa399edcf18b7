"""The canvas on which beams are drawn: how many scans ended in each cell, and how many passed."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mapmyworld.errors import MapError, NothingToDrawError
from mapmyworld.kernels.rays import count_scans
from mapmyworld.mapping.beams import Beams

_MARGIN = 64  # cells by which the canvas outgrows what is needed, so that it seldom grows
_MOST_MARKS = 255  # scans that a cell's mark indicates apart
_MOST_CELLS = 400_000_000  # of the canvas; beyond, some range or pose is nonsense


@dataclass(frozen=True, slots=True, eq=False)
class Counts:
    """Of each cell, how many scans ended in it and how many passed."""

    corner: NDArray[np.int64]
    """(2,) lattice cell of the first one."""
    hits: NDArray[np.uint16]
    """(H, W)."""
    passes: NDArray[np.uint16]
    """(H, W)."""


class Canvas:
    """Counts of hits and passes on a lattice through the map's origin; grows as scans come."""

    def __init__(self) -> None:
        self._corner = np.zeros(2, np.int64)  # lattice cell of the canvas's cell (0, 0)
        self._hits = np.zeros((0, 0), np.uint16)
        self._passes = np.zeros((0, 0), np.uint16)
        self._marks = np.zeros((0, 0), np.uint8)
        self._mark = 0
        self._used = np.zeros((2, 2), np.int64)  # lattice cells, first and one beyond the last

    def add(self, beams: Beams) -> None:
        """Draws the beams of at most 255 scans."""
        if not len(beams.ends):
            return
        ends, starts = beams.ends, beams.starts
        used = starts[np.diff(beams.bounds) > 0]
        low = np.floor(np.minimum(ends.min(axis=0), used.min(axis=0))).astype(np.int64)
        high = np.floor(np.maximum(ends.max(axis=0), used.max(axis=0))).astype(np.int64)
        self._cover(low - 1, high + 1)  # with a cell of margin around
        if self._mark + len(starts) > _MOST_MARKS:
            self._marks, self._mark = np.zeros_like(self._marks), 0
        count_scans(
            self._hits, self._passes, self._marks, self._mark,
            starts - self._corner, ends - self._corner, beams.is_hit, beams.bounds,
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
        if (self._used[1] > self._used[0]).all():
            low, high = np.minimum(low, self._used[0]), np.maximum(high, self._used[1] - 1)
        self._used = np.array([low, high + 1])

    def seen(self) -> Counts:
        """The part that was seen, one cell of margin around.

        Raises `NothingToDrawError` where nothing was.
        """
        rows, columns = (
            np.flatnonzero(self._hits.any(axis=axis) | self._passes.any(axis=axis))
            for axis in (1, 0)
        )
        if not len(rows):
            raise NothingToDrawError(
                "no scan has a return in range: there is nothing to draw a grid of"
            )
        part = np.s_[rows[0] - 1 : rows[-1] + 2, columns[0] - 1 : columns[-1] + 2]
        corner = self._corner + np.array([columns[0], rows[0]]) - 1
        return Counts(corner, self._hits[part], self._passes[part])


def _checked_size(size: NDArray[np.int64]) -> tuple[int, int]:
    """Width and height of a canvas, unless they are nonsense."""
    width, height = size.tolist()
    if width * height > _MOST_CELLS:
        raise MapError(
            f"the grid would be {width} x {height} cells: raise mapping.resolution or lower "
            "mapping.range_max"
        )
    return width, height
