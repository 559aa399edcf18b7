"""One coloured cloud of all depth images at their final poses."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mapmyworld.config import Config
from mapmyworld.geometry import invert, transform_points
from mapmyworld.mapping.voxels import VoxelMap
from mapmyworld.registration.camera import depth_at, depth_grid_points, grid_rays, pixels_of_points
from mapmyworld.types import NodeData, PointCloud, RgbdImage

Array = NDArray[np.float64]
Posed = tuple[Array, NodeData]


def build_cloud(items: Iterable[Posed], config: Config) -> PointCloud:
    """The cloud of all nodes given as (map_from_base (4, 4), data), in the order of motion.

    Streams: three views and the voxels of the map are all that is held. A point counts when its
    surface is not seen too flat and the views before and after do not look through it.
    3D scans of nodes without a depth image are added as they are, without colour.
    """
    settings = config.visual
    voxels = VoxelMap(settings.cloud_voxel)
    for before, view, after in _with_neighbours(_views(items, config)):
        others = [other for other in (before, after) if other is not None]
        kept = _agreeing(view, others, settings.cloud_agreement)
        voxels.add(view.points[kept], view.colours[kept], view.normals[kept])
    return voxels.to_cloud(settings.cloud_views)


@dataclass(frozen=True, slots=True, eq=False)
class _View:
    """One image's points in the map, and what is needed to look through them from elsewhere."""

    image: RgbdImage | None
    depth: NDArray[np.float32]
    map_from_camera: Array
    points: Array
    colours: NDArray[np.uint8]
    normals: NDArray[np.float32]


def _views(items: Iterable[Posed], config: Config) -> Iterator[_View]:
    for map_from_base, data in items:
        images = [image for image in data.images if image.depth is not None]
        for image in images:
            yield _view_of_image(map_from_base @ image.camera.base_from_camera, image, config)
        if not images and data.cloud is not None and len(data.cloud):
            yield _view_of_scan(map_from_base, data.cloud)


def _view_of_scan(map_from_base: Array, cloud: NDArray[np.float32]) -> _View:
    points = transform_points(map_from_base, cloud)
    grey = np.full((len(points), 3), 128, np.uint8)
    none = np.zeros((len(points), 3), np.float32)
    return _View(None, np.zeros((1, 1), np.float32), map_from_base, points, grey, none)


def _view_of_image(map_from_camera: Array, image: RgbdImage, config: Config) -> _View:
    settings = config.visual
    pixels, depth = depth_grid_points(image, settings.cloud_stride)
    camera_points = organised_points(image, pixels, depth)
    normals, slant = organised_normals(camera_points)
    good = (depth > settings.depth_min) & (depth < settings.cloud_range)
    good &= slant > np.cos(np.radians(settings.cloud_view_angle))
    points = transform_points(map_from_camera, camera_points[good])
    turned = normals[good] @ map_from_camera[:3, :3].T
    colours = colours_at(image, pixels[good])
    return _View(image, depth, map_from_camera, points, colours, turned.astype(np.float32))


def organised_points(
    image: RgbdImage, pixels: Array, depth: NDArray[np.float32]
) -> NDArray[np.float32]:
    """Points (h, w, 3) in the camera's frame of a lattice of pixels (h, w, 2)."""
    rays = grid_rays(image.camera, pixels)
    return np.concatenate([rays * depth[..., None], depth[..., None]], axis=-1)


def organised_normals(
    points: NDArray[np.float32],
) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """Unit normals (h, w, 3) towards the camera, and the cosine (h, w) of the angle to the ray.

    By the cross product of central differences. At the rim and beside missing depth the normal
    and the cosine are 0; across a jump in depth the surface seems slanted, so its cosine is small.
    """
    normals = np.zeros_like(points)
    cosines = np.zeros(points.shape[:2], np.float32)
    if min(points.shape[:2]) < 3:
        return normals, cosines
    right = points[1:-1, 2:] - points[1:-1, :-2]
    down = points[2:, 1:-1] - points[:-2, 1:-1]
    known = points[..., 2] > 0
    whole = (
        known[1:-1, 2:] & known[1:-1, :-2] & known[2:, 1:-1] & known[:-2, 1:-1] & known[1:-1, 1:-1]
    )
    cross = np.cross(down, right)
    length = np.linalg.norm(cross, axis=-1)
    whole &= length > 1e-12
    unit = cross / np.where(whole, length, 1.0)[..., None]
    centre = points[1:-1, 1:-1]
    distance = np.maximum(np.linalg.norm(centre, axis=-1), 1e-6)
    cosine = -np.sum(unit * centre, axis=-1) / distance
    unit = np.where(cosine[..., None] < 0, -unit, unit)
    normals[1:-1, 1:-1] = np.where(whole[..., None], unit, 0.0)
    cosines[1:-1, 1:-1] = np.where(whole, np.abs(cosine), 0.0)
    return normals, cosines


def colours_at(image: RgbdImage, pixels: Array) -> NDArray[np.uint8]:
    """RGB (N, 3) of pixels (N, 2); grey 128 where there is no colour image."""
    if image.colour is None:
        return np.full((len(pixels), 3), 128, np.uint8)
    picture = np.asarray(image.colour.pixels(), np.uint8)
    u = np.clip(np.round(pixels[:, 0]).astype(int), 0, picture.shape[1] - 1)
    v = np.clip(np.round(pixels[:, 1]).astype(int), 0, picture.shape[0] - 1)
    found = picture[v, u]
    return found if found.ndim == 2 else np.repeat(found[:, None], 3, axis=1)


def _with_neighbours(
    views: Iterable[_View],
) -> Iterator[tuple[_View | None, _View, _View | None]]:
    """Each view between the one before it and the one after it."""
    before: _View | None = None
    current: _View | None = None
    for after in views:
        if current is not None:
            yield before, current, after
        before, current = current, after
    if current is not None:
        yield before, current, None


def _agreeing(view: _View, others: list[_View], share: float) -> NDArray[np.bool_]:
    """Mask (N,) of the points that no other view looks through, unless another one sees them."""
    seen = np.zeros(len(view.points), np.int32)
    pierced = np.zeros(len(view.points), np.int32)
    for other in others:
        if other.image is None:
            continue
        local = transform_points(invert(other.map_from_camera), view.points)
        there = depth_at(other.image, other.depth, pixels_of_points(other.image.camera, local))
        excess = (there - local[:, 2]) / np.maximum(local[:, 2], 1e-6)
        seen += np.abs(excess) < share
        pierced += excess > share
    return np.asarray((pierced == 0) | (seen > pierced))
