"""A level slice of a 3D lidar's points: the planar scan of logs that have no other."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from mapmyworld.config import SensingConfig
from mapmyworld.errors import LogError
from mapmyworld.geometry import Array
from mapmyworld.geometry.planar import matrix_to_planar
from mapmyworld.geometry.rigid import transform_points
from mapmyworld.types import PointCloudMessage, Scan

_BINS = 720  # of half a degree around the lidar: what such lidars resolve
_SECTORS = 72
_FARTHEST = 1e4  # m; no lidar sees farther


def points_of_cloud(
    message: PointCloudMessage, base_from_lidar: NDArray[np.float64], settings: SensingConfig
) -> Array:
    """Points (N, 3) of the base frame, the robot's own body left out; `LogError` without any.

    By `base_from_lidar` (4, 4). Nothing indicates when each point was taken, so the sweep keeps the
    robot's motion.
    """
    points = transform_points(base_from_lidar, message.points.astype(np.float64))
    away = points[:, :2] - base_from_lidar[:2, 3]
    ranges = np.hypot(away[:, 0], away[:, 1])
    points = points[(ranges >= settings.cloud_nearest) & (ranges < _FARTHEST)]
    if not len(points):
        raise LogError("a cloud without points")
    return points


def scan_of_points(
    points: Array, base_from_lidar: NDArray[np.float64], settings: SensingConfig
) -> Scan:
    """The nearest point of each bearing in the slice of heights; points (N, 3) of the base frame.

    Bearings are about the lidar at `base_from_lidar` (4, 4). Those without one are unknown rather
    than free: what stands there may be lower or higher.
    """
    heights = points[:, 2]
    points = points[(heights >= settings.cloud_lowest) & (heights <= settings.cloud_highest)]
    origin = matrix_to_planar(base_from_lidar)
    away = points[:, :2] - origin[:2]
    bearings = np.arctan2(away[:, 1], away[:, 0]) - origin[2]
    bins = np.floor(bearings * (_BINS / (2.0 * np.pi))).astype(np.int64) % _BINS
    order = np.lexsort((np.hypot(away[:, 0], away[:, 1]), bins))
    _, first = np.unique(bins[order], return_index=True)
    return Scan(
        points=np.ascontiguousarray(points[order[first], :2], np.float32),
        origin=origin,
        missing=np.zeros(0, np.float32),
        range_max=np.inf,
        angle_increment=2.0 * np.pi / _BINS,
    )


def thinned(cloud: NDArray[np.float32], spacing: float) -> NDArray[np.float32]:
    """The first of the points (N, 3) in each cube of this edge, metres, in their order, (K, 3)."""
    _, first = np.unique(np.floor(cloud / spacing), axis=0, return_index=True)
    return cloud[np.sort(first)]


def view_of(scan: Scan) -> float:
    """Radians of the sectors, of five degrees each, in which a slice shows something."""
    away = scan.points - scan.origin[:2]
    sectors = np.floor(np.arctan2(away[:, 1], away[:, 0]) * (_SECTORS / (2.0 * np.pi)))
    return len(np.unique(sectors)) * 2.0 * np.pi / _SECTORS
