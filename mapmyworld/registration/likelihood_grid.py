"""How likely a surface is, cell by cell, and what bounds that over whole squares of shifts."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view
from numpy.typing import NDArray

from mapmyworld.geometry import Array
from mapmyworld.kernels.branch_and_bound import FULL, LEVELS, RESOLUTION, SIDE, SQUARE, UNSEEN

PART = 4
"""Squares on each side of a part of a whole map, which is looked at if any of it is known."""
BESIDE = 0.5
"""What a point in a cell beside a surface adds to a search, of a hit's whole.

A place that lies off by half a cell has many such points.
"""
_BESIDE = UNSEEN + int(BESIDE * (FULL - UNSEEN))


@dataclass(frozen=True, eq=False)
class LikelihoodGrid:
    """How likely a surface is, cell by cell, and its maxima over ever larger squares."""

    cells: NDArray[np.uint8]
    """(H, W), 255 where there is one."""
    corner: Array
    """(2,) of the first unpadded cell, in the frame of the points."""

    @staticmethod
    def of(cells: NDArray[np.uint8], surfaces: NDArray[np.int64], corner: Array) -> LikelihoodGrid:
        """Of cells (H, W), free or not seen, and columns and rows (N, 2) of those with a surface.

        The first one that is not padding is at `corner` (2,).
        """
        x, y = surfaces.T
        cells[y + 1, x] = cells[y - 1, x] = cells[y, x + 1] = cells[y, x - 1] = _BESIDE
        cells[y, x] = FULL
        return LikelihoodGrid(cells, corner)

    @cached_property
    def pyramid(self) -> NDArray[np.uint8]:
        """(L, H, W) of L levels, the cells first; only a search needs it."""
        pyramid = np.empty((LEVELS, *self.cells.shape), np.uint8)
        pyramid[0] = self.cells
        for level, (below, above) in enumerate(pairwise(pyramid)):
            reach = 1 << level  # as far as the grid goes
            np.maximum(below[:, :-reach], below[:, reach:], out=above[:, :-reach])
            np.maximum(below[:, -reach:], below[:, -1:], out=above[:, -reach:])
            np.maximum(above[:-reach], above[reach:], out=above[:-reach])
            np.maximum(above[-reach:], above[-1:], out=above[-reach:])
        return pyramid

    @cached_property
    def strips(self) -> NDArray[np.int8]:
        """(X, 2, Y, SIDE): more than unseen, as `best_shift` sums it up over squares of shifts.

        Cells are half a square wide, and hold the maxima of the top level over their width. Strip
        by strip along y, every other row apart, lie `SIDE` of them, every other one along x.
        """
        top, half = self.pyramid[-1], SQUARE // 2
        height, width = (SQUARE * -(-size // SQUARE) for size in top.shape)
        room = SIDE * SQUARE  # on either side of x: some of a strip may lie outside
        padded = np.full((height, width + 2 * room), UNSEEN, np.uint8)
        padded[: top.shape[0], room : room + top.shape[1]] = top
        maxima = np.maximum(padded[::half], padded[half - 1 :: half])
        maxima = np.maximum(maxima[:, ::half], maxima[:, half - 1 :: half])
        known = (maxima.astype(np.int16) - UNSEEN).astype(np.int8)
        strips = sliding_window_view(known, 2 * SIDE - 1, axis=1)[..., ::2]
        rows, count, _ = strips.shape
        return np.ascontiguousarray(strips.reshape(rows // 2, 2, count, SIDE).transpose(2, 1, 0, 3))

    @cached_property
    def parts(self) -> NDArray[np.int64]:
        """(S, 2) lower left cells of the parts of which anything is known, from `corner`."""
        width = PART * SQUARE
        rows, columns = np.nonzero(self.cells != UNSEEN)
        known = np.stack([columns, rows], axis=1) - SQUARE
        return np.unique(known // width, axis=0) * width

    @property
    def bounds(self) -> tuple[Array, Array]:
        """The lower left and the upper right corner, (2,) both, m, of what is not padding."""
        height, width = self.cells.shape
        return self.corner, self.corner + RESOLUTION * (np.array([width, height]) - 2 * SQUARE)
