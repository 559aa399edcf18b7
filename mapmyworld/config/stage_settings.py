"""The stage of a build that first reads each setting: from there on it must be done again."""

from __future__ import annotations

from collections.abc import Mapping
from fnmatch import fnmatchcase
from typing import Any

from mapmyworld.config import Config
from mapmyworld.config.settings import list_settings

_TRACKED = (
    "sensing.*_tolerance",
    "sensing.scan_offset",
    "sensing.camera_offset",
    "sensing.imu_offset",
    "sensing.node_*",
    "sensing.cloud_spacing",
    "odometry.keyframe_*",
    "odometry.contradiction",
    "odometry.least_overlap",
    "odometry.search_*",
    "registration.*",
    "storage.*",
)
"""Of following a log by either method."""
FIRST_READ: Mapping[str, tuple[str, ...]] = {
    "plan": (
        "sensing.*_topic",
        "sensing.base_frame",
        "sensing.*_mount",
        "sensing.use_*",
        "sensing.odometry_offset",
        "sensing.cloud_lowest",
        "sensing.cloud_highest",
        "sensing.cloud_nearest",
    ),
    "track": (
        *_TRACKED,
        "visual.depth_*",
        "visual.feature*",
        "visual.fast_threshold",
        "visual.inlier_sigmas",
        "visual.closure_inliers",
    ),
    "recognise": (
        "seed",
        "places.laser_far_spacing",
        "places.laser_spacing",
        "places.laser_submap",
        "places.laser_revisits",
        "graph.tolerance",
        "graph.robust",
        "graph.*_probability",
        "visual.marker*",
        "visual.place_*",
    ),
    "optimise": (
        "odometry.refine*",
        "graph.groups",
        "graph.covariances",
        "graph.certify",
    ),
    "map": ("mapping.*", "visual.grid_*", "visual.obstacle_*"),
}
"""Of a build by the graph. What no stage names changes no map: threads, limits, exports."""
FIRST_READ_BY_PARTICLES: Mapping[str, tuple[str, ...]] = {
    "plan": FIRST_READ["plan"],
    "track": (
        *_TRACKED,
        "seed",
        "odometry.refine*",
        "places.laser_far_spacing",
        "places.laser_submap",
        "places.laser_revisits",
        "graph.tolerance",
        "graph.robust",
        "graph.*_probability",
        "particles.*",
        "visual.depth_min",
    ),
    "fastslam": (),
    "map": ("mapping.*",),
}
"""The same of `--method fastslam`, whose particles carry maps of their own."""


def settings_of(
    stage: str, config: Config, first_read: Mapping[str, tuple[str, ...]] = FIRST_READ
) -> dict[str, Any]:
    """Name -> value of the settings that this stage is the first one to read."""
    return {
        setting.name: setting.value
        for setting in list_settings(config)
        if any(fnmatchcase(setting.name, pattern) for pattern in first_read[stage])
    }
