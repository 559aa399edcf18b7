"""Points gathered in voxels: memory grows with the volume seen, not with the number of views."""

from __future__ import annotations

from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from mapmyworld.kernels.voxels import BITS, OFFSET, STEPS, TURNS, add_points, fill_table
from mapmyworld.types import PointCloud

Kind = TypeVar("Kind", bound=np.generic)

_ROOM = 1 << 16  # voxels that there is room for at first
_AT_ONCE = 1 << 16  # voxels whose means are taken together


class VoxelMap:
    """Means of position, colour and normal of the first 255 points that fell into each voxel."""

    def __init__(self, size: float) -> None:
        """`size` is the edge of a voxel in metres."""
        self._size = size
        self._count = 0
        self._keys = np.zeros(_ROOM, np.int64)
        # Sums over a voxel's points: count, offset from the voxel's corner, RGB, normal.
        self._sums = np.zeros((_ROOM, 10), np.uint16)
        self._table = np.zeros(2 * _ROOM, np.int32)

    def add(
        self,
        points: NDArray[np.float64],
        colours: NDArray[np.uint8],
        normals: NDArray[np.float32],
    ) -> None:
        """Adds points (N, 3) in metres with RGB (N, 3) and unit normals (N, 3), zero = unknown."""
        self._make_room(len(points))
        self._count = add_points(
            np.ascontiguousarray(points, np.float64),
            np.ascontiguousarray(colours),
            np.ascontiguousarray(normals),
            self._size,
            self._table,
            self._keys,
            self._sums,
            self._count,
        )

    def to_cloud(self, least_count: int = 1, around: float = 0.0) -> PointCloud:
        """The means of the voxels, in the order of keys, with enough points near them.

        Enough is `least_count` in the cube of about `around` metres that the voxel is part of: so
        finer voxels, of which each holds fewer points, are not left out for being fine.
        """
        kept = np.flatnonzero(self._points_in_cubes(around) >= least_count)
        kept = kept[np.argsort(self._keys[kept], kind="stable")]
        count = len(kept)
        cloud = PointCloud(
            np.empty((count, 3), np.float32),
            np.empty((count, 3), np.uint8),
            np.empty((count, 3), np.float32),
        )
        for start in range(0, count, _AT_ONCE):
            self._write_means(kept[start : start + _AT_ONCE], cloud, start)
        return cloud

    def _points_in_cubes(self, edge: float) -> NDArray[np.int64]:
        """For each voxel the points (K,) of all voxels in its cube, which is of whole voxels."""
        counts = self._sums[: self._count, 0].astype(np.int64)
        voxels = round(edge / self._size)
        if voxels <= 1:
            return counts
        x, y, z = (c // voxels for c in _indices(self._keys[: self._count]))
        _, cube = np.unique(x << 2 * BITS | y << BITS | z, return_inverse=True)
        return np.asarray(np.bincount(cube, counts).astype(np.int64)[cube])

    def _write_means(self, rows: NDArray[np.int64], cloud: PointCloud, start: int) -> None:
        """The means of these voxels, into the cloud from `start` on."""
        assert cloud.colours is not None
        assert cloud.normals is not None
        chosen = slice(start, start + len(rows))
        keys, sums = self._keys[rows], self._sums[rows]
        cells = np.stack(_indices(keys), axis=1) - OFFSET
        means = sums[:, 1:] / np.maximum(sums[:, :1], 1).astype(np.float32)
        normals = means[:, 6:] / TURNS - 1.0
        length = np.linalg.norm(normals, axis=1, keepdims=True)
        known = length > 0.5 / TURNS  # less is no direction, but rounding
        cloud.points[chosen] = (cells + (means[:, :3] + 0.5) / STEPS) * self._size
        cloud.colours[chosen] = np.clip(np.round(means[:, 3:6]), 0, 255)
        cloud.normals[chosen] = normals / np.where(known, length, np.inf)

    def _make_room(self, more: int) -> None:
        """Doubles what holds the voxels until `more` fit, and spreads them over a new table."""
        room = len(self._keys)
        while room < self._count + more:
            room *= 2
        if room == len(self._keys):
            return
        self._keys = _grown(self._keys, room)
        self._sums = _grown(self._sums, room)
        self._table = np.zeros(2 * room, np.int32)
        fill_table(self._table, self._keys, self._count)


def _indices(keys: NDArray[np.int64]) -> tuple[NDArray[np.int64], ...]:
    """A voxel's index along each axis, counted from the far corner, out of its key."""
    mask = (1 << BITS) - 1
    return keys >> 2 * BITS, (keys >> BITS) & mask, keys & mask


def _grown(rows: NDArray[Kind], room: int) -> NDArray[Kind]:
    grown = np.zeros((room, *rows.shape[1:]), rows.dtype)
    grown[: len(rows)] = rows
    return grown
