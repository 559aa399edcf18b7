"""How likely a surface is, cell by cell, and what bounds that over whole squares of shifts."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view
from numpy.typing import NDArray

from mapmyworld.geometry import Array
from mapmyworld.kernels.branch_and_bound import FULL, SIDE, mark_beside

RESOLUTION = 0.1
"""m, of cells."""
UNSEEN = FULL - FULL // 2
"""Of a cell that no beam passed: it speaks for no pose and against none."""
_BESIDE = FULL // 2 + UNSEEN // 2  # of a cell beside a surface: it speaks half as much for a pose
_LEVELS = 4  # of the pyramid: the coarsest bounds 0.8 m x 0.8 m of shifts
SQUARE = 1 << (_LEVELS - 1)
"""Cells of these shifts, to each side."""


@dataclass(frozen=True, eq=False)
class LikelihoodGrid:
    """How likely a surface is, cell by cell, and its maxima over ever larger squares."""

    cells: NDArray[np.uint8]
    """(H, W), 255 where there is one."""
    corner: Array
    """(2,) of the first unpadded cell, in the frame of the points."""
    margin: int
    resolution: float
    unseen: int
    """Value of a cell of which nothing is known."""

    @staticmethod
    def of(cells: NDArray[np.uint8], corner: Array, margin: int) -> LikelihoodGrid:
        """Of cells (H, W) that hold a surface, are free or not seen, the first at `corner` (2,)."""
        mark_beside(cells, _BESIDE)
        return LikelihoodGrid(cells, corner, margin, RESOLUTION, UNSEEN)

    @cached_property
    def pyramid(self) -> NDArray[np.uint8]:
        """(L, H, W) of L levels, the cells first; only a search needs it."""
        pyramid = np.empty((_LEVELS, *self.cells.shape), np.uint8)
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
        top, half, outside = self.pyramid[-1], SQUARE // 2, self.unseen
        height, width = (SQUARE * -(-size // SQUARE) for size in top.shape)
        room = SIDE * SQUARE  # on either side of x: some of a strip may lie outside
        padded = np.full((height, width + 2 * room), outside, np.uint8)
        padded[: top.shape[0], room : room + top.shape[1]] = top
        maxima = np.maximum(padded[::half], padded[half - 1 :: half])
        maxima = np.maximum(maxima[:, ::half], maxima[:, half - 1 :: half])
        known = (maxima.astype(np.int16) - outside).astype(np.int8)
        strips = sliding_window_view(known, 2 * SIDE - 1, axis=1)[..., ::2]
        rows, count, _ = strips.shape
        return np.ascontiguousarray(strips.reshape(rows // 2, 2, count, SIDE).transpose(2, 1, 0, 3))

    @property
    def bounds(self) -> tuple[Array, Array]:
        """The lower left and the upper right corner, (2,) both, m, of what is not padding."""
        height, width = self.cells.shape
        return self.corner, self.corner + self.resolution * (
            np.array([width, height]) - 2 * self.margin
        )
