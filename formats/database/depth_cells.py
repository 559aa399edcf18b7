"""A camera node's local grid: the cells in which its depth shows floor, or something in the way."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np
from numpy.typing import NDArray

from formats.database.node_rows import StorageOptions
from mapmyworld.geometry.rigid import transform_points
from mapmyworld.types import CameraModel, RgbdImage

_COLUMNS = 160  # pixels across that are looked at, about
_SUPPORT = 3  # points that make an obstacle; single ones are noise


def depth_cells(
    images: Iterable[RgbdImage], options: StorageOptions
) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """Centres of the cells of floor (1, N, 2) and of obstacles (1, M, 2) within reach.

    In m, base frame. The floor is the base's x-y plane: what is nearer to it than `obstacle_lowest`
    is ground.
    """
    points = np.concatenate(
        [np.empty((0, 3))]
        + [_points(i.camera, i.depth.pixels()) for i in images if i.depth is not None]
    )
    size, half = options.local_cell_size, round(options.local_cell_range / options.local_cell_size)
    near = np.hypot(points[:, 0], points[:, 1]) < options.local_cell_range
    points = points[near & (points[:, 2] < options.obstacle_highest)]
    cells = np.rint(points[:, :2] / size).astype(np.int64) + half
    places = cells[:, 1] * (2 * half + 1) + cells[:, 0]
    level = np.abs(points[:, 2]) <= options.obstacle_lowest
    count = (2 * half + 1) ** 2
    ground = np.bincount(places[level], minlength=count) > 0
    obstacle = np.bincount(places[points[:, 2] > options.obstacle_lowest], minlength=count)
    blocked = obstacle >= _SUPPORT
    return _centres(ground & ~blocked, half, size), _centres(blocked, half, size)


def _points(camera: CameraModel, pixels: NDArray[np.generic]) -> NDArray[np.float64]:
    """Points (N, 3) of the base frame of a depth image, thinned."""
    depth = np.asarray(pixels, np.float64)
    scale = camera.width / depth.shape[1] if camera.width else 1.0
    step = max(1, depth.shape[1] // _COLUMNS)
    rows, cols = (np.arange(0, side, step) for side in depth.shape)
    v, u = np.meshgrid(rows, cols, indexing="ij")
    z = depth[::step, ::step]
    seen = z > 0.0
    rays = np.stack(
        [(u[seen] + 0.5) * scale - 0.5, (v[seen] + 0.5) * scale - 0.5, np.ones(seen.sum())]
    )
    local = (np.linalg.inv(camera.intrinsics) @ rays) * z[seen]
    return transform_points(camera.base_from_camera, local.T)


def _centres(mask: NDArray[np.bool_], half: int, size: float) -> NDArray[np.float32]:
    rows, cols = np.divmod(np.flatnonzero(mask), 2 * half + 1)
    return (np.column_stack([cols - half, rows - half]) * size).astype(np.float32)[None]
