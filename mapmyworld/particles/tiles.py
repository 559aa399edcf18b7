"""Maps of many particles in tiles that are copied only when a particle writes to them."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from mapmyworld.geometry.planar import transform_points_planar
from mapmyworld.kernels.rays import clear_passed
from mapmyworld.parallel import run_in_chunks
from mapmyworld.particles.kernels import insertion
from mapmyworld.particles.kernels.surface_tiles import TILE, Beams, Surfaces

_EMPTY = 0  # slot of the tile in which nothing was ever observed
_MARGIN = 4  # tiles added around what is needed when the world outgrows the tables


class TileMaps:
    """`count` maps; particles with a common past share the tiles of that past."""

    def __init__(self, count: int, resolution: float, threads: int) -> None:
        self.threads = threads
        self._owners = np.zeros(64, np.int32)
        cells = TILE * TILE
        self.surfaces = Surfaces(
            tables=np.zeros((count, 1, 1), np.int32),
            hits=np.zeros((64, cells), np.uint8),
            visits=np.zeros((64, cells), np.uint8),
            means=np.zeros((64, cells, 2), np.uint8),
            normals=np.zeros((64, cells, 2), np.int8),
            base=np.zeros(2, np.int64),
            resolution=resolution,
        )
        """The arrays that kernels read and write."""

    def insert(self, beams: Beams, poses: NDArray[np.float64]) -> None:
        """Adds a scan to every particle's map at its own pose (P, 3)."""
        self._make_room(poses, _reach(beams))
        maps = self.surfaces
        self._make_own(_touched(maps, beams, poses))
        given = beams, poses, self._owners
        run_in_chunks(lambda a, b: insertion.insert(maps, a, b, *given), len(poses), self.threads)

    def resample(self, ancestors: NDArray[np.int64]) -> None:
        """Particle k continues with the map of `ancestors[k]`, of (P,); nothing is copied."""
        self.surfaces = self.surfaces._replace(tables=self.surfaces.tables[ancestors])
        self._count_owners()

    def _count_owners(self) -> None:
        tables = self.surfaces.tables.ravel()
        self._owners = np.bincount(tables, minlength=len(self._owners)).astype(np.int32)
        self._owners[_EMPTY] = 0

    def _make_own(self, touched: NDArray[np.bool_]) -> None:
        """Gives particles their own copy of every touched tile that they share, or lack."""
        maps = self.surfaces
        shared = touched & (self._owners[maps.tables] != 1)
        old = maps.tables[shared]
        free = np.flatnonzero(self._owners == 0)[1:]
        if len(free) < len(old):
            self._grow(len(old) - len(free))
            free = np.flatnonzero(self._owners == 0)[1:]
        new = free[: len(old)].astype(np.int32)
        for array in (maps.hits, maps.visits, maps.means, maps.normals):
            array[new] = array[old]
        maps.tables[shared] = new
        self._count_owners()

    def _grow(self, missing: int) -> None:
        count = len(self._owners) + max(missing, len(self._owners) // 8)
        maps = self.surfaces
        for array in (self._owners, maps.hits, maps.visits, maps.means, maps.normals):
            # In place: a copy would need twice the memory for a moment.
            array.resize((count, *array.shape[1:]), refcheck=False)

    def _make_room(self, poses: NDArray[np.float64], reach: float) -> None:
        """Widens the tables so that all within `reach` of the poses lies inside."""
        maps = self.surfaces
        tables, base, side = maps.tables, maps.base, TILE * maps.resolution
        low = np.floor((poses[:, 1::-1].min(axis=0) - reach) / side).astype(np.int64) - 1
        high = np.floor((poses[:, 1::-1].max(axis=0) + reach) / side).astype(np.int64) + 2
        size = np.array(tables.shape[1:])
        if np.all(low >= base) and np.all(high <= base + size):
            return
        before = np.where(low < base, low - _MARGIN, base)
        after = np.where(high > base + size, high + _MARGIN, base + size)
        wider, (y, x) = np.zeros((len(tables), *(after - before)), np.int32), base - before
        wider[:, y : y + size[0], x : x + size[1]] = tables
        self.surfaces = maps._replace(tables=wider, base=before)


def _touched(maps: Surfaces, beams: Beams, poses: NDArray[np.float64]) -> NDArray[np.bool_]:
    """(P, H, W) tiles that a scan changes, seen from `poses` (P, 3).

    Those in which beams end, and of those that are only crossed the ones that already hold
    something: free space alone is nothing to match with.
    """
    side, corner = TILE * maps.resolution, maps.base[::-1]
    starts = transform_points_planar(poses, beams.origin[None]) / side - corner
    ends = transform_points_planar(poses, beams.points) / side - corner
    untouched, bounds = np.ones(maps.tables.shape, np.uint8), np.array([0, len(beams.points)])
    for tiles, start, end in zip(untouched, starts, ends, strict=True):
        clear_passed(tiles, start, end, bounds)
    touched: NDArray[np.bool_] = (untouched == 0) & (maps.tables != _EMPTY)
    columns, rows = ends.astype(np.int64).T
    touched[np.arange(len(poses)), rows, columns] = True
    return touched


def _reach(beams: Beams) -> float:
    """Metres from the robot to the farthest point of a scan or to the lidar."""
    squared = np.sum(beams.points**2, axis=1)
    return float(np.sqrt(max(np.max(squared, initial=0.0), np.sum(beams.origin**2))))
