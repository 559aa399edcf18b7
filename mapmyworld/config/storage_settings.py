"""Settings of what map.db keeps and how."""

from __future__ import annotations

from dataclasses import dataclass

from mapmyworld.config.ranges import CellSide, Positive, Quality, Reach


@dataclass(frozen=True, slots=True)
class StorageConfig:
    """Settings of what map.db keeps, and how."""

    store_images: bool = True  # keep colour and depth images of the nodes
    image_codec: str = "jpeg"  # "jpeg" or "png"; recorded JPEG files are kept as they are
    image_quality: Quality = 95  # JPEG quality, 1 to 100
    depth_codec: str = "rvl"  # "rvl" or "png" (whole mm; recorded PNG is kept), or "float" (exact)
    local_cells: bool = True  # keep local grids for rtabmap-export --map
    local_cell_size: CellSide = 0.05  # m, side of a cell of the local grids
    local_cell_range: Reach = 5.0  # m, reach of the local grids, as RTAB-Map's Grid/RangeMax
    local_cell_spacing: Positive = 1.0  # m between nodes that carry a local grid
