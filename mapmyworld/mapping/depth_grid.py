"""A planar scan from a depth image, so that robots without a laser get a grid as well."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from mapmyworld.config import Config
from mapmyworld.geometry import Array
from mapmyworld.geometry.planar import matrix_to_planar, planar_to_matrix
from mapmyworld.geometry.rigid import between, transform_points
from mapmyworld.mapping.cloud_map import organised_surface
from mapmyworld.types import RgbdImage, Scan

_FLOOR_TOLERANCE = 0.05  # m above or below the floor that still counts as floor
_FLOOR_TILT = 15.0  # deg between the floor's normal and the base's z axis, at most
_FLOOR_PRIOR = 0.15  # m that the floor may differ from the base's z = 0
_BEAM = 0.5  # deg between the beams
_STRIDE = 4  # pixels between the points looked at
_SUPPORT = 3  # points that an obstacle needs in a beam; single ones are noise
_ENOUGH_FLOOR = 200  # points for a plane to be fitted
_LOWEST_CAMERA = 0.05  # m above the floor
_GAP = 3.0  # rows of looked-at pixels that may be missing between two points of the floor
_FAR = 0.9  # share of the range up to which an empty beam must have been seen


@dataclass(frozen=True, slots=True, eq=False)
class _Seen:
    """Points of a depth image as a lidar at the camera's place would sort them; all parallel."""

    beams: NDArray[np.int64]
    """(N,) number of the beam, `_BEAM` apart."""
    ranges: Array
    """(N,) m from the camera, level."""
    heights: Array
    """(N,) m above the floor."""
    upward: Array
    """(N,) z of the surface's normal."""
    camera_height: float
    """m above the floor."""


def scan_from_depth(image: RgbdImage, config: Config) -> Scan:
    """What a lidar at the camera's place would see of everything that is in a robot's way.

    The base's x-y plane is the prior for the floor; the floor in view corrects it. Points between
    `visual.obstacle_lowest` and `obstacle_highest` above it stop a beam. One that nothing stops
    passes as far as floor is seen without a gap, and is empty where anything distant is seen.
    """
    settings = config.visual
    origin = _origin(image.camera.base_from_camera)
    seen = _seen(image, origin, config)
    near = seen.ranges < settings.grid_range
    blocking = near & (seen.heights > settings.obstacle_lowest)
    blocking &= seen.heights < settings.obstacle_highest
    hit, distance = _nearest(seen.beams[blocking], seen.ranges[blocking])
    stopped = np.unique(seen.beams[blocking])
    far = np.unique(seen.beams[seen.ranges > _FAR * settings.grid_range])
    bare, reached = _floor_reach(seen, near, _STRIDE / image.camera.intrinsics[1, 1])
    free = ~np.isin(bare, stopped)
    step = np.radians(_BEAM)
    return Scan(
        _ends(origin, hit * step, distance),
        origin,
        np.setdiff1d(far, stopped).astype(np.float32) * np.float32(step),
        settings.grid_range,
        float(step),
        _ends(origin, bare[free] * step, reached[free]),
    )


def _seen(image: RgbdImage, origin: Array, config: Config) -> _Seen:
    """Points (N,) of an image, about the `origin` (3,) of its camera in the base's plane."""
    settings = config.visual
    _, depth, local, normals, _ = organised_surface(image, _STRIDE)
    base_from_camera = image.camera.base_from_camera
    known = (depth > settings.depth_min) & (depth < 2.0 * settings.grid_range)
    points = transform_points(base_from_camera, local[known])
    upward = normals[known] @ base_from_camera[2, :3]
    found = floor_plane(points, upward)  # z = 0 where none is seen
    floor = np.zeros(len(points)) if found is None else _heights(points, found[0])
    offset = points[:, :2] - origin[:2]
    bearings = np.arctan2(offset[:, 1], offset[:, 0])
    beams = np.round(bearings / np.radians(_BEAM)).astype(np.int64)
    above = float(base_from_camera[2, 3] - np.median(floor)) if len(floor) else 0.0
    return _Seen(
        beams,
        np.linalg.norm(offset, axis=1),
        points[:, 2] - floor,
        upward,
        max(above, _LOWEST_CAMERA),
    )


def planar_scan(image: RgbdImage, map_from_base: Array, config: Config) -> tuple[Array, Scan]:
    """The pose (3,) in the plane of a node at `map_from_base` (4, 4), and what its depth image
    indicates there, also where the camera was carried.
    """
    image = levelled_image(image, map_from_base) if image.camera.is_carried else image
    return matrix_to_planar(map_from_base), scan_from_depth(image, config)


def levelled_image(image: RgbdImage, map_from_base: Array) -> RgbdImage:
    """An image of a carried camera as if its base stood level on the map's floor, at the place
    and heading of the pose (4, 4) in the plane.
    """
    stood = planar_to_matrix(matrix_to_planar(map_from_base))
    mount = between(stood, map_from_base) @ image.camera.base_from_camera
    return replace(image, camera=replace(image.camera, base_from_camera=mount))


def floor_plane(points: Array, upward: Array) -> tuple[Array, NDArray[np.bool_]] | None:
    """The floor's slopes along x and y and its height at the origin (3,), and which points lie on
    it (N,); None where too few are in view.

    The plane through the points (N, 3) of the base frame near z = 0 whose normals point up,
    `upward` (N,) being the normals' z.
    """
    level = upward > np.cos(np.radians(_FLOOR_TILT))
    on_plane = level & (np.abs(points[:, 2]) < _FLOOR_PRIOR)
    plane = np.zeros(3)
    middle = points[on_plane, :2].mean(axis=0) if on_plane.any() else np.zeros(2)
    for _ in range(3):
        if np.count_nonzero(on_plane) < _ENOUGH_FLOOR:
            return None
        across = points[on_plane, :2] - middle
        design = np.column_stack([across, np.ones(len(across))])
        ridge = np.diag([1.0, 1.0, 0.0])  # slopes stay 0 where a thin strip of floor is in view
        plane = np.linalg.solve(design.T @ design + ridge, design.T @ points[on_plane, 2])
        plane[2] -= middle @ plane[:2]
        on_plane = level & (np.abs(points[:, 2] - _heights(points, plane)) < _FLOOR_TOLERANCE)
    is_steep = np.hypot(*plane[:2]) > np.tan(np.radians(_FLOOR_TILT))
    return None if is_steep or np.count_nonzero(on_plane) < _ENOUGH_FLOOR else (plane, on_plane)


def _heights(points: Array, plane: Array) -> Array:
    """Heights (N,) of a plane (3,) below points (N, 3)."""
    return np.asarray(points[:, :2] @ plane[:2] + plane[2])


def _origin(base_from_camera: Array) -> Array:
    forward = base_from_camera[:2, 2]
    yaw = np.arctan2(forward[1], forward[0])
    return np.array([base_from_camera[0, 3], base_from_camera[1, 3], yaw])


def _nearest(beams: NDArray[np.int64], ranges: Array) -> tuple[NDArray[np.int64], Array]:
    """Beams with an obstacle, and the range of the first few points that agree."""
    order = np.lexsort((ranges, beams))
    beams, ranges = beams[order], ranges[order]
    found, starts, counts = np.unique(beams, return_index=True, return_counts=True)
    enough = counts >= _SUPPORT
    return found[enough], ranges[starts[enough] + _SUPPORT - 1]


def _floor_reach(
    seen: _Seen, near: NDArray[np.bool_], pixel: float
) -> tuple[NDArray[np.int64], Array]:
    """Beams along which floor is seen, and up to which range without a gap.

    Points looked at are `pixel` rad apart. A beam narrower than that has gaps of its own, so they
    are looked for in sectors that hold two columns of them.
    """
    low = near & (np.abs(seen.heights) < _FLOOR_TOLERANCE)
    sectors = seen.beams // (2 + int(2.0 * pixel / np.radians(_BEAM)))
    floor = low & (seen.upward > np.cos(np.radians(_FLOOR_TILT)))
    floor[low] &= _without_gap(sectors[low], seen.ranges[low], seen.camera_height, pixel)
    order = np.lexsort((-seen.ranges[floor], seen.beams[floor]))
    found, farthest = np.unique(seen.beams[floor][order], return_index=True)
    return found, seen.ranges[floor][order][farthest]


def _without_gap(
    sectors: NDArray[np.int64], ranges: Array, height: float, pixel: float
) -> NDArray[np.bool_]:
    """(N,) low points before the first gap of their sector; none of sectors with few.

    From `height` h a row of pixels lies pixel (r^2 + h^2) / h farther away than the row before.
    """
    order = np.lexsort((ranges, sectors))
    _, starts, counts = np.unique(sectors[order], return_index=True, return_counts=True)
    before = np.concatenate([[0.0], ranges[order]])[:-1]
    broken = ranges[order] - before > _GAP * pixel * (before**2 + height**2) / height
    broken[starts] = False
    breaks = np.cumsum(broken)
    whole = np.empty(len(order), np.bool_)
    whole[order] = breaks == np.repeat(breaks[starts], counts)
    return whole & np.isin(sectors, sectors[order][starts[counts >= _SUPPORT]])


def _ends(origin: Array, bearings: Array, ranges: Array) -> NDArray[np.float32]:
    """(N, 2) where beams of these bearings and ranges about the origin end."""
    along = np.stack([np.cos(bearings), np.sin(bearings)], axis=1)
    return np.asarray(origin[:2] + ranges[:, None] * along, np.float32)
