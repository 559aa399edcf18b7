"""A level slice of a 3D lidar's points: the planar scan of logs that have no other."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from mapmyworld.config import SensingConfig
from mapmyworld.errors import LogError
from mapmyworld.geometry import Array, matrix_to_planar, transform_points
from mapmyworld.types import PointCloudMessage, Scan

_BINS = 720  # of half a degree around the lidar: what such lidars resolve
_SECTORS = 72
_FARTHEST = 1e4  # m; no lidar sees farther


def scan_from_cloud(
    message: PointCloudMessage, base_from_lidar: NDArray[np.float64], settings: SensingConfig
) -> Scan:
    """The nearest point of each bearing in the slice of heights, in the base frame.

    Bearings without one are unknown rather than free: what stands there may be lower or higher.
    Nothing tells when each point was taken, so the sweep keeps the robot's motion.
    """
    if not message.points.size:
        raise LogError("a cloud without points")
    origin = matrix_to_planar(base_from_lidar)
    points = _slice(message.points, base_from_lidar, settings)
    away = points[:, :2] - origin[:2]
    ranges = np.hypot(away[:, 0], away[:, 1])
    kept = (ranges >= settings.cloud_nearest) & (ranges < _FARTHEST)
    bearings = np.arctan2(away[kept, 1], away[kept, 0]) - origin[2]
    bins = np.floor(bearings * (_BINS / (2.0 * np.pi))).astype(np.int64) % _BINS
    order = np.lexsort((ranges[kept], bins))
    _, first = np.unique(bins[order], return_index=True)
    return Scan(
        points=np.ascontiguousarray(points[kept][order[first], :2], np.float32),
        origin=origin,
        missing=np.zeros(0, np.float32),
        range_max=np.inf,
        angle_increment=2.0 * np.pi / _BINS,
    )


def _slice(cloud: NDArray[np.float32], base_from_lidar: Array, settings: SensingConfig) -> Array:
    """Points (N, 3) of the base frame whose heights are between the lowest and the highest."""
    points = transform_points(base_from_lidar, cloud.astype(np.float64))
    heights = points[:, 2]
    return points[(heights >= settings.cloud_lowest) & (heights <= settings.cloud_highest)]


def view_of(scan: Scan) -> float:
    """Radians of the sectors, of five degrees each, in which a slice shows something."""
    away = scan.points - scan.origin[:2]
    sectors = np.floor(np.arctan2(away[:, 1], away[:, 0]) * (_SECTORS / (2.0 * np.pi)))
    return len(np.unique(sectors)) * 2.0 * np.pi / _SECTORS
