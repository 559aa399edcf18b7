"""Settings of what map.db keeps and how."""

from __future__ import annotations

from dataclasses import dataclass

from mapmyworld.config.ranges import Quality


@dataclass(frozen=True, slots=True)
class StorageConfig:
    """Settings of what map.db keeps, and how."""

    store_images: bool = True  # keep colour and depth images of the nodes
    image_codec: str = "jpeg"  # "jpeg" or "png"; recorded JPEG files are kept as they are
    image_quality: Quality = 95  # JPEG quality, 1 to 100
    depth_codec: str = "rvl"  # "rvl" or "png" (whole mm; recorded PNG is kept), or "float" (exact)
