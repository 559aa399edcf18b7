"""How sharp a grid is: a good map is confident of its cells, and its walls are thin."""

from __future__ import annotations

from dataclasses import asdict, dataclass

import numpy as np
from numpy.typing import NDArray

from mapmyworld.types import OccupancyGrid


@dataclass(frozen=True, slots=True)
class Sharpness:
    """Figures of one grid; comparable between grids of one log at one resolution."""

    entropy_bits: float
    """Mean entropy of the observed cells: 0 when all are certain, 1 when nothing is known."""
    wall_thickness_m: float
    """Mean thickness of what is occupied; not a number where nothing is."""

    def as_dict(self) -> dict[str, float | None]:
        """By name, as JSON values."""
        return {k: None if np.isnan(v) else float(v) for k, v in asdict(self).items()}


def grid_sharpness(grid: OccupancyGrid) -> Sharpness:
    """Entropy and wall thickness; doubled and blurred walls raise both."""
    thickness = _thickness(grid.trinary() == 100) * grid.resolution
    return Sharpness(_mean_entropy(grid), thickness)


def _mean_entropy(grid: OccupancyGrid) -> float:
    p = grid.probabilities()[np.isfinite(grid.log_odds)].astype(np.float64)
    if len(p) == 0:
        return float("nan")
    p = np.clip(p, 1e-12, 1.0 - 1e-12)
    return float(np.mean(-p * np.log2(p) - (1.0 - p) * np.log2(1.0 - p)))


def _thickness(occupied: NDArray[np.bool_]) -> float:
    """Cells across a wall: twice its area over its outline.

    A wall of thickness t and a much greater length L has the area tL and the outline 2L. The
    outline is counted in cell edges, which is exact along the lattice and too long by up to the
    root of two across it: compare maps of one building in one orientation.
    """
    framed = np.pad(occupied, 1)
    edges = np.count_nonzero(framed[1:] != framed[:-1])
    edges += np.count_nonzero(framed[:, 1:] != framed[:, :-1])
    return 2.0 * np.count_nonzero(occupied) / edges if edges else float("nan")
