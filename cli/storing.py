"""The settings of a build as the database wants them."""

from __future__ import annotations

from dataclasses import asdict
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from mapmyworld.config import Config


def storage_arguments(config: Config) -> dict[str, Any]:
    """Arguments of `formats.database.open_store` for a map built with this configuration."""
    visual = config.visual
    heights = {
        "obstacle_lowest": visual.obstacle_lowest,
        "obstacle_highest": visual.obstacle_highest,
    }
    return {**asdict(config.storage), **heights, "parameters": rtabmap_parameters(config)}


def rtabmap_parameters(config: Config) -> dict[str, str]:
    """Settings that have a counterpart in RTAB-Map, under its names."""
    visual = config.visual
    return {
        "Grid/3D": "false",
        "Grid/MaxGroundHeight": str(visual.obstacle_lowest),
        "Grid/MaxObstacleHeight": str(visual.obstacle_highest),
        "Grid/RangeMax": str(config.storage.local_cell_range),
        "Kp/MaxFeatures": str(visual.place_features),
        "Mem/ImageCompressionFormat": ".png" if config.storage.image_codec == "png" else ".jpg",
        "Optimizer/Strategy": "2",  # GTSAM
        "RGBD/AngularUpdate": str(config.sensing.node_angle),
        "RGBD/LinearUpdate": str(config.sensing.node_distance),
        "Vis/MaxFeatures": str(visual.feature_count),
        "Vis/MinInliers": str(visual.closure_inliers),
    }
