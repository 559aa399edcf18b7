"""Settings of everything that looks at images: features, tracking, places, clouds, meshes."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated

from mapmyworld.config.ranges import Count, FromZero, Positive, Range, Share, Whole

Many = Annotated[int, Range(1, 1_000_000)]
Grey = Annotated[int, Range(1, 255)]
Levels = Annotated[int, Range(1, 32)]
Scale = Annotated[float, Range(1.0, 10.0, is_open=True)]


@dataclass(frozen=True, slots=True)
class VisualConfig:
    """Settings of all that is made of images."""

    cloud_voxel: Positive = 0.02  # m, edge of the cloud's voxels
    cloud_spacing: Positive = 0.25  # m or rad between the nodes whose images make the cloud
    cloud_stride: Count = 4  # pixels between neighbouring points of a view, at most
    depth_min: FromZero = 0.1  # m, nearer depth is ignored
    cloud_range: Positive = 5.0  # m, farther depth is not mapped
    cloud_view_angle: Positive = 75.0  # deg between a surface's normal and the ray to it, at most
    cloud_agreement: FromZero = 0.03  # share of the depth by which two views of a point may differ
    cloud_views: Count = 2  # measurements within 5 cm that a voxel of the cloud needs
    feature_count: Many = 1000  # features kept of an image, spread over it
    fast_threshold: Grey = 7  # grey levels by which a corner stands out
    pyramid_levels: Levels = 8  # scales at which ORB looks
    pyramid_scale: Scale = 1.2  # between neighbouring scales
    depth_max: Positive = 8.0  # m, farther depth gives no 3D point to a feature
    depth_sigma: Positive = 0.007  # 1/m, sigma of inverse depth: that of depth is this times z^2
    depth_outlier: Positive = 0.06  # 1/m by which a feature's inverse depth may be off
    pixel_sigma: Positive = 1.0  # pixels, standard deviation of a feature at the finest scale
    search_radius: Positive = 30.0  # pixels around the prediction in which a point is looked for
    match_bits: Annotated[int, Range(1, 256)] = 64  # of 256 in which matching features may differ
    match_ratio: Share = 0.8  # best distance to second best, at most
    least_inliers: Count = 25  # sightings that agree on a pose, at least
    inlier_sigmas: Positive = 3.0  # a sighting agrees within so many standard deviations
    ransac_rounds: Count = 512  # hypotheses tried for a pose, at most
    motion_noise_translation: Positive = 1.0  # m/s per root of a second, process noise of velocity
    motion_noise_rotation: Positive = 3.0  # rad/s per root of a second, process noise of turning
    keyframe_share: Share = 0.7  # of the last keyframe's points; fewer seen make a new one
    keyframe_distance: FromZero = 0.15  # m of motion that makes a keyframe
    keyframe_angle: FromZero = 0.2  # rad of rotation that makes a keyframe
    window: Count = 8  # keyframes adjusted together while tracking
    local_keyframes: Count = 20  # nearest keyframes whose points are looked for
    kept_keyframes: Count = 200  # keyframes the tracker remembers
    place_features: Count = 600  # features of a node's image for words and closures
    vocabulary_branches: Annotated[int, Range(2)] = 10  # children of a word in its tree
    vocabulary_depth: Count = 4  # levels of the tree: at most branches^depth words
    place_spacing: Positive = 0.5  # m or rad between nodes whose images are compared, with a laser
    place_gap: FromZero = 5.0  # s that two nodes must lie apart to be the same place again
    place_candidates: Whole = 3  # places verified for each node, at most
    place_similarity: Share = 0.02  # cosine of two images' words, at least, for a candidate
    place_posterior: Share = 0.2  # probability of a candidate after smoothing, at least
    closure_inliers: Count = 25  # matches that agree on a closure, at least
    closure_share: Share = 0.25  # of the matches that must agree
    closure_cells: Whole = 5  # of an 8 x 6 lattice over the image that agreeing matches must reach
    closure_radius: Positive = 8.0  # pixels around a found motion's projections for more matches
    closure_translation_sigma: Positive = 0.065  # m, no closure is less certain
    closure_rotation_sigma: Positive = 0.006  # rad, no closure is less certain
    succession: Whole = 2  # nodes before each that its image is compared with, without a laser
    closure_gate: Positive = 3.5  # sigmas of drift by which a closure may contradict tracked poses
    drift_translation: Positive = 0.05  # share of the path that tracked poses may be off by
    drift_rotation: Positive = 0.03  # rad a metre of path that tracked poses may be off by
    drift_turn: Positive = 0.03  # share of all rotation that tracked poses may be off by
    place_nodes: Count = 3000  # nodes compared with each other, evenly chosen from longer logs
    proximity_distance: Positive = 1.5  # m between nodes whose images are compared for being near
    proximity_angle: Positive = 45.0  # deg between their headings, at most
    proximity_candidates: Whole = 2  # near nodes verified for each node, at most
    floor_tolerance: Positive = 0.05  # m above or below the floor that still counts as floor
    floor_tilt: Positive = 15.0  # deg between the floor's normal and the base's z axis, at most
    floor_prior: Positive = 0.15  # m that the floor may differ from the base's z = 0
    obstacle_lowest: float = 0.08  # m above the floor from which something is an obstacle
    obstacle_highest: float = 1.5  # m above the floor; what hangs higher is passed under
    grid_beam: Positive = 0.5  # deg between the beams of a scan made from depth
    grid_range: Positive = 5.0  # m to which a scan is made from depth
    mesh_voxel: Positive = 0.02  # m, edge of the mesh's voxels
    mesh_truncation: Positive = 0.08  # m on either side of a surface that a view informs about
    mesh_views: Count = 2  # measurements that a voxel of the mesh needs
    markers: str = ""  # markers to look for: "4x4_50", "6x6_250", "apriltag_36h11", ...; "" = none
    marker_length: FromZero = 0.0  # m, edge of a marker's black square; 0 = measured by depth
