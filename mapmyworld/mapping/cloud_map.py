"""One coloured cloud of all depth images at their final poses."""

from __future__ import annotations

import itertools
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from functools import partial

import numpy as np
from numpy.typing import NDArray

from mapmyworld.config import Config
from mapmyworld.geometry import Array
from mapmyworld.geometry.rigid import invert, transform_points
from mapmyworld.mapping.voxel_map import VoxelMap
from mapmyworld.parallel import in_threads
from mapmyworld.registration.camera_model import (
    depth_at,
    depth_grid_points,
    grid_rays,
    pixels_of_points,
)
from mapmyworld.registration.image_levels import colours_at
from mapmyworld.types import NodeData, PointCloud, RgbdImage

_STRIDE = 4  # pixels between neighbouring points of a view, at most
_AGREEMENT = 0.03  # share of the depth by which two views of a point may differ
VIEW_ANGLE = 75.0  # deg between a surface's normal and the ray to it, at most
Posed = tuple[Array, NodeData]
Grid = NDArray[np.float32]
_AROUND = 0.05  # m within which measurements of a surface speak for one another
_USUAL = 0.5  # of the cloud's range: at this depth a view has a point for each voxel


def build_cloud(items: Iterable[Posed], config: Config) -> PointCloud:
    """The cloud of all nodes given as (map_from_base (4, 4), data), in the order of motion.

    Streams: a few views and the voxels of the map are all that is held. A point counts when its
    surface is not seen too flat and the views before and after do not look through it.
    Finer voxels are filled by more points of each view.
    3D scans of nodes without a depth image are added as they are, without colour.
    """
    settings = config.visual
    voxels = VoxelMap(settings.cloud_voxel)

    views = in_threads(lambda make: make(), _views(items, config), config.threads)
    for before, view, after in _with_neighbours(views):
        others = [other for other in (before, after) if other is not None]
        kept = _agreeing(view, others, _AGREEMENT)
        voxels.add(view.points[kept], view.colours[kept], view.normals[kept])
    return voxels.to_cloud(settings.cloud_views, _AROUND)


@dataclass(frozen=True, slots=True, eq=False)
class _View:
    """One image's points in the map, and what is needed to look through them from elsewhere."""

    image: RgbdImage | None
    depth: NDArray[np.float32]
    map_from_camera: Array
    points: Array
    colours: NDArray[np.uint8]
    normals: NDArray[np.float32]


def _views(items: Iterable[Posed], config: Config) -> Iterator[Callable[[], _View]]:
    """What makes each view: decoding is left to other threads."""
    for map_from_base, data in items:
        images = [image for image in data.images if image.depth is not None]
        for image in images:
            map_from_camera = map_from_base @ image.camera.base_from_camera
            yield partial(_view_of_image, map_from_camera, image, config)
        if not images and data.cloud is not None and len(data.cloud):
            yield partial(_view_of_scan, map_from_base, data.cloud)


def _view_of_scan(map_from_base: Array, cloud: NDArray[np.float32]) -> _View:
    points = transform_points(map_from_base, cloud)
    grey = np.full((len(points), 3), 128, np.uint8)
    none = np.zeros((len(points), 3), np.float32)
    return _View(None, np.zeros((1, 1), np.float32), map_from_base, points, grey, none)


def _view_of_image(map_from_camera: Array, image: RgbdImage, config: Config) -> _View:
    settings = config.visual
    stride = _stride(image, config)
    pixels, depth, camera_points, normals, slant = organised_surface(image, stride)
    good = (depth > settings.depth_min) & (depth < settings.cloud_range)
    good &= slant > np.cos(np.radians(VIEW_ANGLE))
    points = transform_points(map_from_camera, camera_points[good])
    turned = normals[good] @ map_from_camera[:3, :3].T
    colours = colours_at(image, pixels[good], stride)
    return _View(image, depth, map_from_camera, points, colours, turned.astype(np.float32))


def _stride(image: RgbdImage, config: Config) -> int:
    """Pixels between neighbouring points: as far apart, at the usual depth, as voxels are."""
    settings = config.visual
    depth = _USUAL * settings.cloud_range
    pixels = int(settings.cloud_voxel * image.camera.intrinsics[0, 0] / depth)
    return min(_STRIDE, max(1, pixels))


def organised_surface(image: RgbdImage, stride: int) -> tuple[Array, Grid, Grid, Grid, Grid]:
    """Pixels (H, W, 2) on a lattice, their depths (H, W), m, and points (H, W, 3) in the camera's
    frame, with the normals (H, W, 3) and cosines (H, W) of `organised_normals`.
    """
    pixels, depth = depth_grid_points(image, stride)
    rays = grid_rays(image.camera, pixels)
    points = np.concatenate([rays * depth[..., None], depth[..., None]], axis=-1)
    return pixels, depth, points, *organised_normals(points)


def organised_normals(points: Grid) -> tuple[Grid, Grid]:
    """Unit normals (H, W, 3) towards the camera, and the cosine (H, W) of the angle to the ray.

    By the cross product of central differences of `points` (H, W, 3) in the camera's frame. At the
    rim and beside missing depth the normal and the cosine are 0; across a jump in depth the surface
    seems slanted, so its cosine is small.
    """
    normals, cosines = np.zeros_like(points), np.zeros(points.shape[:2], np.float32)
    inner, z = points[1:-1, 1:-1], points[..., 2]
    down, across = points[2:, 1:-1] - points[:-2, 1:-1], points[1:-1, 2:] - points[1:-1, :-2]
    crossed = np.cross(down, across)
    length, distance = np.linalg.norm(crossed, axis=-1), np.linalg.norm(inner, axis=-1)
    rim = z[1:-1, :-2], z[1:-1, 2:], z[:-2, 1:-1], z[2:, 1:-1], inner[..., 2]
    known = (np.minimum.reduce(rim) > 0.0) & (length > 1e-12)
    unit = crossed[known] / length[known, None]
    cosine = -np.einsum("nc,nc->n", unit, inner[known]) / distance[known]
    normals[1:-1, 1:-1][known] = np.where(cosine < 0.0, -1.0, 1.0)[:, None] * unit
    cosines[1:-1, 1:-1][known] = np.abs(cosine)
    return normals, cosines


def _with_neighbours(
    views: Iterable[_View],
) -> Iterator[tuple[_View | None, _View, _View | None]]:
    """Each view between the one before it and the one after it."""
    before, current = None, None
    for after in itertools.chain(views, [None]):
        if current is not None:
            yield before, current, after
        before, current = current, after


def _agreeing(view: _View, others: list[_View], share: float) -> NDArray[np.bool_]:
    """Mask (N,) of the points that no other view looks through, unless another one sees them."""
    seen, pierced = np.zeros(len(view.points), np.int64), np.zeros(len(view.points), np.int64)
    for other in others:
        if other.image is None:
            continue
        local = transform_points(invert(other.map_from_camera), view.points)
        pixels = pixels_of_points(other.image.camera, local)
        beyond = depth_at(other.image, other.depth, pixels) / local[:, 2] - 1.0
        seen += np.abs(beyond) < share
        pierced += beyond > share
    return np.asarray((pierced == 0) | (seen > pierced))
