"""Settings of everything that looks at images: features, tracking, places, clouds, meshes."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class VisualConfig:
    cloud_voxel: float = 0.02  # m, edge of the cloud's voxels
    cloud_stride: int = 4  # pixels of the full image between neighbouring points of a view
    depth_min: float = 0.1  # m, nearer depth is ignored
    cloud_range: float = 5.0  # m, farther depth is not mapped
    cloud_view_angle: float = 75.0  # deg between a surface's normal and the ray to it, at most
    cloud_agreement: float = 0.03  # share of the depth by which two views of a point may differ
    cloud_views: int = 2  # measurements that a voxel of the cloud needs
