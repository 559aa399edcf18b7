"""How sharp a grid is: a good map is confident of its cells, and its walls are thin."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from mapmyworld.types import OccupancyGrid


@dataclass(frozen=True, slots=True)
class Sharpness:
    """Figures of one grid; comparable between grids of one log at one resolution."""

    entropy_bits: float | None
    """Mean entropy of the observed cells: 0 when all are certain, 1 when nothing is known; None
    where none was observed."""
    wall_thickness_m: float | None
    """Mean thickness of what is occupied; None where nothing is."""


def grid_sharpness(grid: OccupancyGrid) -> Sharpness:
    """Entropy and wall thickness; doubled and blurred walls raise both."""
    p = grid.probabilities()[np.isfinite(grid.log_odds)].astype(np.float64)
    p = np.clip(p, 1e-12, 1.0 - 1e-12)
    entropies, cells = -p * np.log2(p) - (1.0 - p) * np.log2(1.0 - p), _thickness(grid)
    return Sharpness(
        entropy_bits=float(entropies.mean()) if len(p) else None,
        wall_thickness_m=None if cells is None else float(cells * grid.resolution),
    )


def _thickness(grid: OccupancyGrid) -> float | None:
    """Cells across a wall, None without any: twice its area over its outline.

    A wall of thickness t and a much greater length L has the area tL and the outline 2L. The
    outline is counted in cell edges, which is exact along the lattice and too long by up to the
    root of two across it: compare maps of one building in one orientation.
    """
    framed = np.pad(grid.trinary() == 100, 1)
    edges = np.count_nonzero(framed[1:] != framed[:-1])
    edges += np.count_nonzero(framed[:, 1:] != framed[:, :-1])
    return 2.0 * np.count_nonzero(framed) / edges if edges else None
