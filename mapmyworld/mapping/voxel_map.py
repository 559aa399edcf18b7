"""Points gathered in voxels: memory grows with the volume seen, not with the number of views."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from mapmyworld.geometry import Array
from mapmyworld.types import PointCloud

_BITS = 21  # of a voxel index along each axis: a million voxels either way
_OFFSET = 1 << (_BITS - 1)
_WAITING = 1 << 19  # points that are added to their voxels together


class VoxelMap:
    """Means of position, colour and normal of the points that fell into each voxel."""

    def __init__(self, size: float) -> None:
        """`size` is the edge of a voxel in metres."""
        self._size = size
        self._keys = np.zeros(0, np.int64)
        # Sums over a voxel's points: count, place within the voxel, RGB, normal.
        self._sums = np.zeros((0, 10), np.float32)
        self._new: list[tuple[NDArray[np.generic], ...]] = []  # keys, then columns of sums

    def add(self, points: Array, colours: NDArray[np.uint8], normals: NDArray[np.float32]) -> None:
        """Adds points (N, 3) in metres with RGB (N, 3) and unit normals (N, 3), zero = unknown."""
        places = points / self._size
        inside = (np.abs(places) < _OFFSET - 1).all(axis=1)
        cells = np.floor(places[inside]).astype(np.int64)
        x, y, z = (cells + _OFFSET).T
        within = (places[inside] - cells).astype(np.float32)
        keys = x << 2 * _BITS | y << _BITS | z
        self._new.append((keys, within, colours[inside], normals[inside]))
        if sum(len(keys) for keys, *_ in self._new) > _WAITING:
            self._gather()

    def _gather(self) -> None:
        """Adds what is new to the voxels, which stand in the order of their keys."""
        if not self._new:
            return
        points, *parts = (np.concatenate(part) for part in zip(*self._new, strict=True))
        self._new = []
        order = np.argsort(points, kind="stable")
        keys, first, counts = np.unique(points[order], return_index=True, return_counts=True)
        columns = [np.add.reduceat(part[order], first, dtype=np.float32) for part in parts]
        sums = np.hstack([counts[:, None], *columns], dtype=np.float32)
        place = np.searchsorted(self._keys, keys)
        seen = np.isin(keys, self._keys, assume_unique=True)
        self._sums[place[seen]] += sums[seen]
        self._keys = np.insert(self._keys, place[~seen], keys[~seen])
        self._sums = np.insert(self._sums, place[~seen], sums[~seen], axis=0)

    def to_cloud(self, least_count: int = 1, around: float = 0.0) -> PointCloud:
        """The means of the voxels, in the order of keys, with enough points near them.

        Enough is `least_count` in the cube of about `around` metres that the voxel is part of: so
        finer voxels, of which each holds fewer points, are not left out for being fine.
        """
        self._gather()
        kept = self._points_in_cubes(around) >= least_count
        sums = self._sums[kept]
        means = np.divide(sums[:, 1:], sums[:, :1], out=sums[:, 1:])
        points = [
            ((index - _OFFSET + within) * self._size).astype(np.float32)
            for index, within in zip(_indices(self._keys[kept]), means.T, strict=False)
        ]
        length = np.linalg.norm(means[:, 6:], axis=1, keepdims=True)
        return PointCloud(
            np.stack(points, axis=1),
            np.clip(np.round(means[:, 3:6]), 0, 255).astype(np.uint8),
            (means[:, 6:] / np.where(length > 0.0, length, np.inf)).astype(np.float32),
        )

    def _points_in_cubes(self, edge: float) -> NDArray[np.int64]:
        """For each voxel the points (K,) of all voxels in its cube, which is of whole voxels."""
        counts = self._sums[:, 0].astype(np.int64)
        voxels = round(edge / self._size)
        if voxels <= 1:
            return counts
        x, y, z = (c // voxels for c in _indices(self._keys))
        _, cube = np.unique(x << 2 * _BITS | y << _BITS | z, return_inverse=True)
        return np.asarray(np.bincount(cube, counts).astype(np.int64)[cube])


def _indices(keys: NDArray[np.int64]) -> tuple[NDArray[np.int64], ...]:
    """A voxel's index along each axis, counted from the far corner, out of its key."""
    mask = (1 << _BITS) - 1
    return keys >> 2 * _BITS, (keys >> _BITS) & mask, keys & mask
