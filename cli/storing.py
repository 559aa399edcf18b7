"""A build's map as a file: with the settings its database wants, gone if it came to nothing."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Any

from mapmyworld.errors import MapMyWorldError

if TYPE_CHECKING:
    from mapmyworld.config import Config


@contextmanager
def no_empty_map(path: Path) -> Iterator[None]:
    """Where what is done inside fails, a map without nodes goes: nothing could be made of it."""
    try:
        yield
    except MapMyWorldError:
        if _is_empty_map(path):
            path.unlink()
        raise


def _is_empty_map(path: Path) -> bool:
    from formats.database import open_store
    from formats.database.connection import says_ours

    if not path.is_file() or not says_ours(path):
        return False
    try:
        with open_store(path, read_only=True) as store:
            return not store.nodes()
    except MapMyWorldError:
        return False


def storage_arguments(config: Config) -> dict[str, Any]:
    """Arguments of `formats.database.open_store` for a map built with this configuration."""
    return {**asdict(config.storage), "parameters": rtabmap_parameters(config)}


def rtabmap_parameters(config: Config) -> dict[str, str]:
    """Settings that have a counterpart in RTAB-Map, under its names."""
    visual = config.visual
    return {
        "Grid/3D": "false",
        "Grid/CellSize": str(config.mapping.resolution),
        "Grid/MaxGroundHeight": str(visual.obstacle_lowest),
        "Grid/MaxObstacleHeight": str(visual.obstacle_highest),
        "Kp/MaxFeatures": str(visual.place_features),
        "Mem/ImageCompressionFormat": ".png" if config.storage.image_codec == "png" else ".jpg",
        "Optimizer/Strategy": "2",  # GTSAM
        "RGBD/AngularUpdate": str(config.sensing.node_angle),
        "RGBD/LinearUpdate": str(config.sensing.node_distance),
        "Vis/MaxFeatures": str(visual.feature_count),
        "Vis/MinInliers": str(visual.closure_inliers),
    }
