"""A planar scan from a depth image, so that robots without a laser get a grid as well."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from mapmyworld.config import Config
from mapmyworld.geometry.planar import matrix_to_planar, planar_to_matrix
from mapmyworld.geometry.rigid import between, transform_points
from mapmyworld.mapping.cloud import organised_normals, organised_points
from mapmyworld.registration.camera import depth_grid_points
from mapmyworld.types import RgbdImage, Scan

Array = NDArray[np.float64]
_STRIDE = 4  # pixels between the points looked at
_SUPPORT = 3  # points that an obstacle needs in a beam; single ones are noise
_ENOUGH_FLOOR = 200  # points for a plane to be fitted
_FAR = 0.9  # share of the range up to which an empty beam must have been seen


def scan_from_depth(image: RgbdImage, config: Config) -> Scan:
    """What a lidar at the camera's place would see of everything that is in a robot's way.

    The base's x-y plane is the prior for the floor; the floor in view corrects it. Points between
    `visual.obstacle_lowest` and `obstacle_highest` above it stop a beam. A beam in which floor
    or distant things are seen, and nothing in the way, is empty. Others tell nothing.
    """
    settings = config.visual
    pixels, depth = depth_grid_points(image, _STRIDE)
    local = organised_points(image, pixels, depth)
    normals, _ = organised_normals(local)
    base_from_camera = image.camera.base_from_camera
    known = (depth > settings.depth_min) & (depth < 2.0 * settings.grid_range)
    points = transform_points(base_from_camera, local[known])
    upward = normals[known] @ base_from_camera[2, :3]
    heights = points[:, 2] - floor_heights(points, upward, config)
    origin = _origin(base_from_camera)
    offset = points[:, :2] - origin[:2]
    ranges = np.linalg.norm(offset, axis=1)
    step = np.radians(settings.grid_beam)
    beams = np.round(np.arctan2(offset[:, 1], offset[:, 0]) / step).astype(np.int64)
    blocking = (heights > settings.obstacle_lowest) & (heights < settings.obstacle_highest)
    hit, distance = _nearest(beams[blocking], ranges[blocking], settings.grid_range)
    reach = dict(zip(*_farthest(beams, ranges), strict=True))
    stopped = set(hit.tolist()) | set(beams[blocking & (ranges < settings.grid_range)].tolist())
    empty = [b for b, r in reach.items() if r > _FAR * settings.grid_range and b not in stopped]
    bearings = hit * step
    returns = origin[:2] + distance[:, None] * np.stack(
        [np.cos(bearings), np.sin(bearings)], axis=1
    )
    return Scan(
        returns.astype(np.float32),
        origin,
        np.array(sorted(empty), np.float32) * np.float32(step),
        settings.grid_range,
        float(step),
    )


def levelled_image(image: RgbdImage, map_from_base: Array) -> RgbdImage:
    """An image of a carried camera as if its base stood level on the map's floor, at the place
    and heading of the pose (4, 4) in the plane.
    """
    stood = planar_to_matrix(matrix_to_planar(map_from_base))
    mount = between(stood, map_from_base) @ image.camera.base_from_camera
    return replace(image, camera=replace(image.camera, base_from_camera=mount))


def floor_heights(points: Array, upward: Array, config: Config) -> Array:
    """Height (N,) of the floor below points (N, 3) of the base frame.

    The plane through the points near z = 0 whose normals point up, `upward` (N,) being the normals'
    z; where too few are in view z = 0 itself.
    """
    settings = config.visual
    level = upward > np.cos(np.radians(settings.floor_tilt))
    level &= np.abs(points[:, 2]) < settings.floor_prior
    if np.count_nonzero(level) < _ENOUGH_FLOOR:
        return np.zeros(len(points))
    middle = points[level, :2].mean(axis=0)
    plane = np.zeros(3)
    for _ in range(3):
        design = np.column_stack([points[level, :2] - middle, np.ones(np.count_nonzero(level))])
        ridge = np.diag([1.0, 1.0, 0.0])  # slopes stay 0 where a thin strip of floor is in view
        plane = np.linalg.solve(design.T @ design + ridge, design.T @ points[level, 2])
        found = (points[:, :2] - middle) @ plane[:2] + plane[2]
        level = np.abs(points[:, 2] - found) < settings.floor_tolerance
        level &= upward > np.cos(np.radians(settings.floor_tilt))
        if np.count_nonzero(level) < _ENOUGH_FLOOR:
            return np.zeros(len(points))
    if np.hypot(*plane[:2]) > np.tan(np.radians(settings.floor_tilt)):
        return np.zeros(len(points))
    return np.asarray((points[:, :2] - middle) @ plane[:2] + plane[2])


def _origin(base_from_camera: Array) -> Array:
    forward = base_from_camera[:2, 2]
    yaw = np.arctan2(forward[1], forward[0])
    return np.array([base_from_camera[0, 3], base_from_camera[1, 3], yaw])


def _nearest(
    beams: NDArray[np.int64], ranges: Array, limit: float
) -> tuple[NDArray[np.int64], Array]:
    """Beams with an obstacle within `limit`, and the range of the first few points that agree."""
    order = np.lexsort((ranges, beams))
    order = order[ranges[order] < limit]
    beams, ranges = beams[order], ranges[order]
    found, starts, counts = np.unique(beams, return_index=True, return_counts=True)
    enough = counts >= _SUPPORT
    return found[enough], ranges[starts[enough] + _SUPPORT - 1]


def _farthest(beams: NDArray[np.int64], ranges: Array) -> tuple[list[int], list[float]]:
    order = np.lexsort((-ranges, beams))
    found, starts = np.unique(beams[order], return_index=True)
    return found.tolist(), ranges[order][starts].tolist()
