"""Points gathered in voxels: memory grows with the volume seen, not with the number of views."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from mapmyworld.types import PointCloud

_PENDING = 400_000  # points collected before they are merged; merging costs as much as the map
_BITS = 21  # of a voxel index along each axis: a million voxels either way
_OFFSET = 1 << (_BITS - 1)


class VoxelMap:
    """Means of position, colour and normal of all points that fell into each voxel."""

    def __init__(self, size: float) -> None:
        """`size` is the edge of a voxel in metres."""
        self._size = size
        self._keys = np.zeros(0, np.int64)
        # Sums over a voxel's points: count, offset from the voxel's corner, RGB, normal.
        self._sums = np.zeros((0, 10), np.float32)
        self._pending: list[tuple[NDArray[np.int64], NDArray[np.float32]]] = []
        self._pending_size = 0

    def add(
        self,
        points: NDArray[np.float64],
        colours: NDArray[np.uint8],
        normals: NDArray[np.float32],
    ) -> None:
        """Adds points (N, 3) in metres with RGB (N, 3) and unit normals (N, 3), zero = unknown."""
        cells = np.floor(points / self._size)
        inside = (np.abs(cells) < _OFFSET).all(axis=1)
        cells, points = cells[inside].astype(np.int64), points[inside]
        shifted = cells + _OFFSET
        keys = (shifted[:, 0] << 2 * _BITS) | (shifted[:, 1] << _BITS) | shifted[:, 2]
        values = np.empty((len(keys), 10), np.float32)
        values[:, 0] = 1.0
        values[:, 1:4] = points - cells * self._size
        values[:, 4:7] = colours[inside]
        values[:, 7:] = normals[inside]
        keys, values = _sum_by_key(keys, values)
        self._pending.append((keys, values))
        self._pending_size += len(keys)
        if self._pending_size > max(_PENDING, len(self._keys) // 2):
            self._merge()

    def to_cloud(self, least_count: int = 1) -> PointCloud:
        """The means of the voxels that hold at least `least_count` points, in the order of keys."""
        self._merge()
        kept = self._sums[:, 0] >= least_count
        keys, sums = self._keys[kept], self._sums[kept]
        mask = (1 << _BITS) - 1
        cells = np.stack([keys >> 2 * _BITS, (keys >> _BITS) & mask, keys & mask], axis=1) - _OFFSET
        means = sums[:, 1:] / np.maximum(sums[:, :1], 1.0)
        length = np.linalg.norm(means[:, 6:], axis=1, keepdims=True)
        return PointCloud(
            (cells * self._size + means[:, :3]).astype(np.float32),
            np.clip(np.round(means[:, 3:6]), 0, 255).astype(np.uint8),
            (means[:, 6:] / np.where(length > 1e-6, length, np.inf)).astype(np.float32),
        )

    def _merge(self) -> None:
        keys = np.concatenate([self._keys, *(keys for keys, _ in self._pending)])
        sums = np.concatenate([self._sums, *(sums for _, sums in self._pending)])
        self._pending.clear()
        self._pending_size = 0
        self._keys, self._sums = _sum_by_key(keys, sums)


def _sum_by_key(
    keys: NDArray[np.int64], values: NDArray[np.float32]
) -> tuple[NDArray[np.int64], NDArray[np.float32]]:
    """Ascending distinct keys and the sums of their rows."""
    if len(keys) == 0:
        return keys, values
    order = np.argsort(keys, kind="stable")
    keys = keys[order]
    starts = np.flatnonzero(np.concatenate([[True], keys[1:] != keys[:-1]]))
    return keys[starts], np.add.reduceat(values[order], starts, axis=0, dtype=np.float32)
