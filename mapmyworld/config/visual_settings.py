"""Settings of everything that looks at images: features, tracking, places, clouds, meshes."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated

from mapmyworld.config.ranges import Count, FromZero, Positive, Range, Share

Many = Annotated[int, Range(1, 1_000_000)]
Grey = Annotated[int, Range(1, 255)]


@dataclass(frozen=True, slots=True)
class VisualConfig:
    """Settings of all that is made of images."""

    cloud_voxel: Positive = 0.02  # m, edge of the cloud's voxels
    cloud_spacing: Positive = 0.25  # m or rad between the nodes whose images make the cloud
    depth_min: FromZero = 0.1  # m, nearer depth is ignored
    cloud_range: Positive = 5.0  # m, farther depth is not mapped
    cloud_views: Count = 2  # measurements within 5 cm that a voxel of the cloud needs
    feature_count: Many = 1000  # features kept of an image, spread over it
    fast_threshold: Grey = 7  # grey levels by which a corner stands out
    depth_max: Positive = 8.0  # m, farther depth gives no 3D point to a feature
    depth_sigma: Positive = 0.007  # 1/m, sigma of inverse depth: that of depth is this times z^2
    inlier_sigmas: Positive = 3.0  # a sighting agrees within so many standard deviations
    place_features: Count = 600  # features of a node's image for words and closures
    place_similarity: Share = 0.02  # cosine of two images' words, at least, for a candidate
    place_posterior: Share = 0.2  # probability of a candidate after smoothing, at least
    closure_inliers: Count = 25  # matches that agree on a pose or a closure, at least
    obstacle_lowest: float = 0.08  # m above the floor from which something is an obstacle
    obstacle_highest: float = 1.5  # m above the floor; what hangs higher is passed under
    grid_range: Positive = 5.0  # m to which a scan is made from depth
    mesh_voxel: Positive = 0.02  # m, edge of the mesh's voxels
    markers: str = ""  # markers to look for: "4x4_50", "6x6_250", "apriltag_36h11", ...; "" = none
    marker_length: FromZero = 0.0  # m, edge of a marker's black square; 0 = measured by depth
