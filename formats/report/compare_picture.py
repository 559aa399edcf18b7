"""Several maps of one log in one picture, at one scale."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from formats.report.map_axes import (
    WIDTH,
    caption,
    draw_grid,
    figure_file,
    frame,
    observed_corners,
)
from mapmyworld.types import OccupancyGrid

_PATH = "#1e5ac8"
_COLUMNS = 3  # at most


@dataclass(frozen=True, slots=True, eq=False)
class MapPanel:
    """One of the maps, moved into the frame of the first."""

    grid: OccupancyGrid
    first_from_map: NDArray[np.float64]
    """(3,) x, y, yaw that lays this map upon the first."""
    path: NDArray[np.float64]
    """(K, 2) in this map's own frame."""
    captions: tuple[str, ...]


def write_compare_picture(path: Path, panels: Sequence[MapPanel]) -> None:
    """The maps side by side, two or three a row, each with its captions below."""
    from matplotlib.transforms import Affine2D

    moves = [
        Affine2D().rotate(p.first_from_map[2]).translate(*p.first_from_map[:2]) for p in panels
    ]
    seen = [m.transform(observed_corners(p.grid)) for p, m in zip(panels, moves, strict=True)]
    columns = min(len(panels) if len(panels) < 4 else (len(panels) + 1) // 2, _COLUMNS)
    rows = -(-len(panels) // columns)
    width, height = np.ptp(np.concatenate(seen), axis=0)
    with figure_file(path, rows * (WIDTH / columns * height / width + 0.4)) as figure:
        cells = figure.subplots(rows, columns, squeeze=False).ravel()
        for axes in cells:
            axes.set_aspect("equal")
            axes.axis("off")
        for axes, panel, move in zip(cells, panels, moves, strict=False):
            draw_grid(axes, panel.grid, move)
            axes.plot(*move.transform(panel.path.reshape(-1, 2)).T, color=_PATH, lw=0.6)
            frame(axes, np.concatenate(seen))
            text = "\n".join(map(caption, panel.captions))
            axes.set_title(text, fontsize=6, y=0.0, va="top")
