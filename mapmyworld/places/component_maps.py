"""The map of one connected component: surfaces, and what was seen between them."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple, TypeVar

import numpy as np
from numpy.typing import NDArray

from mapmyworld.config import Config
from mapmyworld.geometry.planar import between_planar, transform_points_planar
from mapmyworld.kernels.branch_and_bound import FULL
from mapmyworld.kernels.rays import count_scans
from mapmyworld.places.laser_nodes import Index, LaserNodes
from mapmyworld.places.laser_submaps import submap_members
from mapmyworld.registration.scan_matching import ScanSet
from mapmyworld.registration.scan_search import (
    LikelihoodGrid,
    likelihood_grid,
    search_grid,
    submap_points,
)

Array = NDArray[np.float64]
Cell = TypeVar("Cell", bound=np.generic)
_NEAR, _TURNED = 0.3, 0.06  # m and rad about a pose within which points are fitted
_BESIDE = 3.0  # cells at both ends of a beam where a surface hides nothing
_POINTS = 300  # of a view, about
_LEAST = 0.1  # score from which there is a best pose at all


class Fit(NamedTuple):
    """How points fit a map at a pose."""

    score: float
    """Mean likelihood of those that lie where the map was seen."""
    seen: float
    """Share of the points that do."""


@dataclass(frozen=True, slots=True, eq=False)
class View:
    """What was seen from around a node, in its frame."""

    points: Array
    """(N, 2)."""
    origins: Array
    """(N, 2) where the laser was that saw each."""


@dataclass(frozen=True, slots=True, eq=False)
class ComponentMap:
    """Surfaces and seen cells, in the frame of the nodes' poses."""

    grid: LikelihoodGrid
    seen: NDArray[np.bool_]
    """(H, W) cells of the grid that hold a surface or that a beam passed."""

    def fit(self, view: View, pose: Array) -> Fit:
        """How well what was seen fits at about this pose (3,).

        A point beyond a surface of the map, which nobody could have seen, fits not at all.
        """
        found = search_grid(view.points, self.grid, pose, _NEAR, _TURNED, _LEAST)
        at = pose if found is None else found.pose
        ends, starts = (_cells(self.grid, transform_points_planar(at, p))
                        for p in (view.points, view.origins))  # fmt: skip
        hidden = self._crossed(starts, ends)
        known = _at(self.seen, ends) | hidden
        likely = float(_at(self.grid.pyramid[0], ends)[known & ~hidden].sum()) / FULL
        count = int(np.count_nonzero(known))
        return Fit(likely / max(count, 1), count / max(len(ends), 1))

    def _crossed(self, starts: Array, ends: Array) -> NDArray[np.bool_]:
        """(N,) whether a surface lies well before the end of each beam."""
        length = np.hypot(*(ends - starts).T)
        along = np.arange(0.0, 1.0, 0.7 / float(length.max(initial=1.0)))
        places = starts[:, None] + along[:, None] * (ends - starts)[:, None]
        free = (along * length[:, None] > _BESIDE) & ((1.0 - along) * length[:, None] > _BESIDE)
        return np.asarray(((_at(self.grid.pyramid[0], places) == FULL) & free).any(axis=1))


def view_around(nodes: LaserNodes, middle: int, config: Config) -> View:
    """What the laser saw along the path around a node."""
    members = submap_members(nodes, middle, config)
    scans = nodes.scans.some(members)
    poses = between_planar(nodes.poses[middle], nodes.poses[members])
    origins = transform_points_planar(poses, scans.origins[:, None])[:, 0]
    points = submap_points(scans, np.arange(len(members)), poses)
    few = slice(None, None, max(1, len(points) // _POINTS))
    return View(points[few], np.repeat(origins, np.diff(scans.bounds), axis=0)[few])


def component_map(nodes: LaserNodes, rows: Index) -> ComponentMap:
    """The map of what was seen from these nodes (K,)."""
    scans, poses = nodes.scans.some(rows), nodes.poses[rows]
    points = submap_points(scans, np.arange(len(rows)), poses)
    grid = likelihood_grid(points)
    return ComponentMap(grid, (grid.pyramid[0] > 0) | _passed(grid, scans, poses, points))


def _passed(grid: LikelihoodGrid, scans: ScanSet, poses: Array, points: Array) -> NDArray[np.bool_]:
    """(H, W) cells that the beams to these points passed, from the grid's edge at the farthest."""
    shape = grid.pyramid.shape[1:]
    origins = transform_points_planar(poses, scans.origins[:, None])[:, 0]
    starts = np.clip(_cells(grid, origins), 0.0, np.array(shape[::-1]) - 1e-3)
    hits, revisits = np.zeros(shape, np.uint16), np.zeros(shape, np.uint16)
    is_hit, marks = np.ones(len(points), np.bool_), np.zeros(shape, np.uint8)
    ends = _cells(grid, points)
    count_scans(hits, revisits, marks, 0, starts, ends, is_hit, scans.bounds)
    return np.asarray(revisits > 0)


def _at(cells: NDArray[Cell], places: Array) -> NDArray[Cell]:
    """(...) values of cells (H, W) at these places (..., 2); zero outside."""
    column, row = np.moveaxis(np.floor(places).astype(np.int64), -1, 0)
    height, width = cells.shape
    inside = (column >= 0) & (row >= 0) & (column < width) & (row < height)
    values = cells[np.where(inside, row, 0), np.where(inside, column, 0)]
    return np.where(inside, values, cells.dtype.type(0))


def _cells(grid: LikelihoodGrid, points: Array) -> Array:
    """(N, 2) columns and rows, with their fractions."""
    return np.ascontiguousarray((points - grid.corner) / grid.resolution + grid.margin)
