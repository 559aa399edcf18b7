"""Several maps of one log in one picture, at one scale."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from formats.report.grid_canvas import canvas_from_grid, observed_bounds
from formats.report.match_picture import Picture, with_caption
from mapmyworld.types import OccupancyGrid

_PATH = (30, 90, 200)  # RGB
_GAP = 12  # pixels between maps


@dataclass(frozen=True, slots=True, eq=False)
class MapPanel:
    """One of the maps, moved into the frame of the first."""

    grid: OccupancyGrid
    first_from_map: NDArray[np.float64]
    """(3,) x, y, yaw that lays this map upon the first."""
    path: NDArray[np.float64]
    """(K, 2) in this map's own frame."""
    captions: tuple[str, ...]


def compare_picture(panels: Sequence[MapPanel], side: int = 700) -> Picture:
    """The maps (H, W, 3) RGB side by side, two or three a row, each with its captions below."""
    grids = [_turned(panel.grid, panel.first_from_map) for panel in panels]
    bounds = np.array([observed_bounds(grid) for grid in grids])
    shared = np.stack([bounds[:, 0].min(axis=0), bounds[:, 1].max(axis=0)])
    tiles = []
    for panel, grid in zip(panels, grids, strict=True):
        canvas = canvas_from_grid(grid, side, shared)
        if len(panel.path) > 1:
            canvas.draw_lines(_moved(panel.path, panel.first_from_map)[None], _PATH)
        tile = canvas.pixels
        for caption in panel.captions:
            tile = with_caption(tile, caption)
        tiles.append(tile)
    return _arranged(tiles)


def _turned(grid: OccupancyGrid, first_from_map: NDArray[np.float64]) -> OccupancyGrid:
    """The same grid on the lattice of the first map's frame; each cell takes its nearest value."""
    height, width = grid.log_odds.shape
    size = np.array([width, height]) * grid.resolution
    corners = grid.origin + np.array([[0, 0], [1, 0], [0, 1], [1, 1]]) * size
    placed = _moved(corners, first_from_map)
    low, high = placed.min(axis=0), placed.max(axis=0)
    columns, rows = np.ceil((high - low) / grid.resolution).astype(int)
    x, y = np.meshgrid(np.arange(columns) + 0.5, np.arange(rows) + 0.5)
    points = low + grid.resolution * np.stack([x, y], axis=-1)
    cos, sin = np.cos(first_from_map[2]), np.sin(first_from_map[2])
    back = (points - first_from_map[:2]) @ np.array([[cos, -sin], [sin, cos]])
    column, row = np.moveaxis(
        np.floor((back - grid.origin) / grid.resolution).astype(np.int64), -1, 0
    )
    inside = (row >= 0) & (column >= 0) & (row < height) & (column < width)
    log_odds = np.full((rows, columns), np.nan, np.float32)
    log_odds[inside] = grid.log_odds[row[inside], column[inside]]
    return OccupancyGrid(
        log_odds, grid.resolution, low, grid.occupied_threshold, grid.free_threshold
    )


def _moved(points: NDArray[np.float64], motion: NDArray[np.float64]) -> NDArray[np.float64]:
    cos, sin = np.cos(motion[2]), np.sin(motion[2])
    return np.asarray(points @ np.array([[cos, sin], [-sin, cos]]) + motion[:2])


def _arranged(tiles: Sequence[Picture]) -> Picture:
    """Tiles of one size in rows of at most three."""
    columns = len(tiles) if len(tiles) < 4 else (len(tiles) + 1) // 2
    columns = min(columns, 3)
    height = max(tile.shape[0] for tile in tiles) + _GAP
    width = max(tile.shape[1] for tile in tiles) + _GAP
    rows = -(-len(tiles) // columns)
    out = np.full((rows * height, columns * width, 3), 255, np.uint8)
    for k, tile in enumerate(tiles):
        y, x = (k // columns) * height, (k % columns) * width
        out[y : y + tile.shape[0], x : x + tile.shape[1]] = tile
    return out
