"""The products: occupancy grids, clouds, meshes and trajectories, and what judges these."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray


@dataclass(frozen=True, slots=True, eq=False)
class OccupancyGrid:
    """Log-odds of occupancy on a square lattice; row 0 is the lowest y, column 0 the lowest x."""

    log_odds: NDArray[np.float32]
    """(H, W); NaN where nothing was observed."""
    resolution: float
    """m, side of a cell."""
    origin: NDArray[np.float64]
    """(2,) x, y of the lower-left corner of cell (0, 0), map frame."""
    occupied_threshold: ClassVar = 0.65
    """Probability from which a cell counts as occupied."""
    free_threshold: ClassVar = 0.196
    """Up to it a cell counts as free; map_saver's unknown grey, 205, reads as 0.196078: above."""

    def probabilities(self) -> NDArray[np.float32]:
        """(H, W) occupancy probability; NaN where unknown."""
        return np.asarray(1.0 / (1.0 + np.exp(-self.log_odds)), np.float32)

    def area_m2(self, value: int) -> float:
        """Area of the cells that are free (0), occupied (100) or unknown (-1)."""
        return float((self.trinary() == value).sum() * self.resolution**2)

    def trinary(self) -> NDArray[np.int8]:
        """(H, W) as nav_msgs/OccupancyGrid: 100 occupied, 0 free, -1 unknown."""
        limits = np.array([self.free_threshold, self.occupied_threshold])
        free, occupied = np.log(limits / (1.0 - limits)).astype(np.float32)
        cells = np.full(self.log_odds.shape, -1, np.int8)
        cells[self.log_odds >= occupied] = 100
        cells[self.log_odds <= free] = 0
        return cells


@dataclass(frozen=True, slots=True, eq=False)
class PointCloud:
    """Points of the map frame."""

    points: NDArray[np.float32]
    """(N, 3) metres."""
    colours: NDArray[np.uint8] | None = None
    """(N, 3) RGB."""
    normals: NDArray[np.float32] | None = None
    """(N, 3) unit vectors."""


@dataclass(frozen=True, slots=True, eq=False)
class Mesh:
    """Triangles of the map frame."""

    vertices: NDArray[np.float32]
    """(V, 3) metres."""
    triangles: NDArray[np.int32]
    """(T, 3) vertex indices, counter-clockwise seen from outside."""
    colours: NDArray[np.uint8] | None = None
    """(V, 3) RGB."""


@dataclass(frozen=True, slots=True, eq=False)
class Trajectory:
    """Poses over time, in the order of motion."""

    stamps_ns: NDArray[np.int64]
    """(N,)."""
    poses: NDArray[np.float64]
    """(N, 4, 4) map_from_base."""


@dataclass(frozen=True, slots=True, eq=False)
class Relations:
    """Known relative poses between moments of a log: the reference of Kuemmerle's metric.

    Parallel arrays, one row a relation; the second moment may precede the first.
    """

    stamps_ns: NDArray[np.int64]
    """(N, 2)."""
    first_from_second: NDArray[np.float64]
    """(N, 4, 4): pose of the robot at the second stamp in its frame at the first."""
