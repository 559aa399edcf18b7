"""A picture of a grid, in which points of the map can be drawn."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from mapmyworld.types import OccupancyGrid

Picture = NDArray[np.uint8]
_UNKNOWN, _FREE, _OCCUPIED = 225, 255, 40  # grey
_MARGIN = 0.5  # m around what was observed
_RING = 10.0  # pixels, the radius of what marks a place
_SHIFT = 4  # bits of a pixel to which lines are drawn


@dataclass(frozen=True, slots=True, eq=False)
class Canvas:
    """Pixels, and how the map lies in them."""

    pixels: Picture
    """(H, W, 3) RGB."""
    origin: NDArray[np.float64]
    """(2,) map coordinates of the lower left corner."""
    scale: float
    """Pixels a metre."""

    def draw_lines(
        self, lines: NDArray[np.floating], colour: tuple[int, int, int], width: int = 1
    ) -> None:
        """Draws open lines (S, N, 2) given in the map."""
        place = (np.asarray(lines, np.float64) - self.origin) * self.scale
        place[..., 1] = len(self.pixels) - place[..., 1]
        # OpenCV counts from the middle of a pixel.
        points = list(np.rint((place - 0.5) * (1 << _SHIFT)).astype(np.int32))
        cv2.polylines(self.pixels, points, False, colour, width, cv2.LINE_AA, _SHIFT)

    def draw_rings(self, centres: NDArray[np.floating], colour: tuple[int, int, int]) -> None:
        """Draws rings of `_RING` pixels about places (L, 2) in the map."""
        angle = np.linspace(0.0, 2.0 * np.pi, 33)
        circle = _RING / self.scale * np.stack([np.cos(angle), np.sin(angle)], axis=-1)
        self.draw_lines(np.asarray(centres, np.float64)[:, None, :] + circle, colour, 2)


def canvas_from_grid(
    grid: OccupancyGrid, side: int, bounds: NDArray[np.float64] | None = None
) -> Canvas:
    """The grid within `bounds` (2, 2), or what of it was observed, about `side` pixels long."""
    bounds = observed_bounds(grid) if bounds is None else bounds
    first = np.floor((bounds[0] - grid.origin) / grid.resolution).astype(int)
    last = np.ceil((bounds[1] - grid.origin) / grid.resolution).astype(int)
    cells = _cut(_grey(grid), first, last)
    ratio = side / max(cells.shape)
    size = (max(round(cells.shape[1] * ratio), 1), max(round(cells.shape[0] * ratio), 1))
    way = cv2.INTER_AREA if ratio < 1.0 else cv2.INTER_NEAREST
    grey = np.asarray(cv2.resize(cells, size, interpolation=way), np.uint8)
    pixels = np.repeat(grey[::-1, :, None], 3, axis=2).copy()
    return Canvas(pixels, grid.origin + first * grid.resolution, ratio / grid.resolution)


def observed_bounds(grid: OccupancyGrid) -> NDArray[np.float64]:
    """Lower left and upper right (2, 2), in metres, of what was observed and a margin around it."""
    rows, columns = np.nonzero(np.isfinite(grid.log_odds))
    if len(rows) == 0:
        return np.stack([grid.origin, grid.origin + 1.0])
    low = grid.origin + grid.resolution * np.array([columns.min(), rows.min()])
    high = grid.origin + grid.resolution * np.array([columns.max() + 1, rows.max() + 1])
    return np.stack([low - _MARGIN, high + _MARGIN])


def _grey(grid: OccupancyGrid) -> NDArray[np.uint8]:
    """(H, W) light where free, dark where occupied."""
    p = grid.probabilities()
    grey = np.where(np.isfinite(p), _FREE + (_OCCUPIED - _FREE) * np.nan_to_num(p), _UNKNOWN)
    return grey.astype(np.uint8)


def _cut(
    cells: NDArray[np.uint8], first: NDArray[np.int64], last: NDArray[np.int64]
) -> NDArray[np.uint8]:
    """Columns and rows `first` to `last` (x, y), unknown where there are none."""
    out = np.full((max(last[1] - first[1], 1), max(last[0] - first[0], 1)), _UNKNOWN, np.uint8)
    low = np.maximum(first, 0)
    high = np.minimum(last, cells.shape[::-1])
    if np.all(high > low):
        x, y = low - first
        w, h = high - low
        out[y : y + h, x : x + w] = cells[low[1] : high[1], low[0] : high[0]]
    return out
