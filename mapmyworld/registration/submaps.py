"""Submaps: what the laser saw along sections of the path, as points and as a grid of evidence."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from mapmyworld.geometry import Array
from mapmyworld.geometry.planar import transform_points_planar
from mapmyworld.kernels.branch_and_bound import RESOLUTION, SQUARE, UNSEEN
from mapmyworld.kernels.cells import first_in_cells
from mapmyworld.kernels.rays import clear_passed
from mapmyworld.registration.likelihood_grid import LikelihoodGrid
from mapmyworld.registration.scan_matching import ScanSet
from mapmyworld.types import OccupancyGrid

POINTS = 140
"""Of a scan or a submap that are scored, at most."""
NATS = 0.23
"""By which a point of a submap speaks for a pose or against it: some four points count as one."""
MARGIN = float(np.log(100.0) / NATS)
"""Evidence, in points, by which a pose is a hundred times as likely as another."""


@dataclass(frozen=True, eq=False)
class Submap:
    """What the laser saw along a section of the path, as one."""

    points: Array
    """(N, 2), scan after scan."""
    origins: Array
    """(S, 2) where each scan's lidar was."""
    bounds: NDArray[np.int64]
    """(S + 1,) where each scan's points begin; the last one ends at N."""
    size: int = 1
    """Times as long as ordinary ones."""

    @staticmethod
    def of(scans: ScanSet, poses: Array, size: int = 1) -> Submap:
        """What scans saw together at their `poses` (S, 3)."""
        origins = transform_points_planar(poses, scans.origins[:, None])[:, 0]
        return Submap(submap_points(scans, poses), origins, scans.bounds, size)

    @cached_property
    def scored(self) -> Array:
        """(P, 2) of the points, which stand for all wherever they are laid on a grid."""
        return scored_points(self.points, self.size * POINTS)

    @property
    def margin(self) -> float:
        """Evidence, in points, by which a pose must surpass others.

        What the poses within a submap err by is common to its points: so many more count as one.
        """
        return self.size * MARGIN

    @property
    def behind(self) -> float:
        """How far behind the best a second best is looked for, in points: any, in longer ones.

        These lie partly where nobody was, and what only one of two poses has seen counts little.
        """
        return MARGIN if self.size == 1 else np.inf


def evidence_grid(submap: Submap) -> LikelihoodGrid:
    """The grid of what scans indicate for and against a surface: 255 for, 0 against, 128 unseen."""
    low = submap.points.min(axis=0, initial=np.inf if len(submap.points) else 0.0)
    corner = low - 2.0 * RESOLUTION
    ends = np.ascontiguousarray((submap.points - corner) / RESOLUTION + SQUARE)
    cells = np.floor(ends).astype(np.int64)
    width, height = cells.max(axis=0, initial=SQUARE) + 3 + SQUARE
    edge = np.array([width, height]) - 1e-3
    starts = np.clip((submap.origins - corner) / RESOLUTION + SQUARE, 0.0, edge)
    found = np.full((height, width), UNSEEN, np.uint8)
    clear_passed(found, starts, ends, submap.bounds)
    return LikelihoodGrid.of(found, cells, corner)


def occupancy_evidence(grid: OccupancyGrid) -> tuple[Array, LikelihoodGrid]:
    """Surface points (N, 2) of an occupancy grid, and the grid of its evidence.

    A cell that is wider than those of evidence fills all that it covers.
    """
    parts = max(int(np.ceil(grid.resolution / RESOLUTION - 1e-6)), 1)
    cells = grid.trinary().repeat(parts, axis=0).repeat(parts, axis=1)
    rows, columns = np.nonzero(cells >= 0)
    middles = (np.stack([columns, rows], axis=1) + 0.5) * (grid.resolution / parts)
    at = np.floor(middles / RESOLUTION).astype(np.int64) + SQUARE + 2
    width, height = at.max(axis=0, initial=SQUARE) + 3 + SQUARE
    known = np.full((height, width), UNSEEN, np.uint8)
    is_hit = cells[rows, columns] == 100
    known[at[~is_hit, 1], at[~is_hit, 0]] = 0
    corner = np.asarray(grid.origin, np.float64) - 2.0 * RESOLUTION
    found = LikelihoodGrid.of(known, at[is_hit], corner)
    return spread_points(grid.origin + middles[is_hit], RESOLUTION), found


def scored_points(points: Array, most: int = POINTS) -> Array:
    """Of points (N, 2) one to a cell, so that what was seen twice counts once, (P, 2); so many at
    most.
    """
    apart = spread_points(points, RESOLUTION)
    few = np.linspace(0, len(apart) - 1, min(most, len(apart))).astype(np.int64)
    return np.ascontiguousarray(apart[few], np.float64)


def spread_points(points: Array, spacing: float) -> Array:
    """The first of points (N, 2) in each cell of edge `spacing`, (K, 2)."""
    return points[first_in_cells(points, spacing)]


def submap_points(scans: ScanSet, poses: Array) -> Array:
    """All points (N, 2) of scans at their `poses` (S, 3)."""
    if len(scans) == 0:
        return np.zeros((0, 2))
    rows, of = rows_of(scans)
    c, s = np.cos(poses[:, 2])[of], np.sin(poses[:, 2])[of]
    x, y = rows[:, 0].astype(np.float64), rows[:, 1].astype(np.float64)
    return np.stack([poses[of, 0] + c * x - s * y, poses[of, 1] + s * x + c * y], axis=-1)


def rows_of(scans: ScanSet, step: int = 1) -> tuple[NDArray[np.float32], NDArray[np.int64]]:
    """Every `step`-th row (N, 6) of each scan, and which scan (N,) it is of."""
    parts = [scans.rows[a:b:step] for a, b in pairwise(scans.bounds.tolist())]
    return np.concatenate(parts), np.repeat(np.arange(len(scans)), [len(part) for part in parts])
