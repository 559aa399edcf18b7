"""Settings of grids, clouds and meshes."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class MappingConfig:
    """Settings of the occupancy grid."""

    resolution: float = 0.05  # m, side of a cell of the grid
    range_max: float = 30.0  # m, beams are drawn up to here
    missing_range: float = 0.0  # m that a beam without return is taken to have passed freely
    hit_probability: float = 0.7  # of being occupied, for a cell in which a beam ended
    miss_probability: float = 0.35  # of being occupied, for a cell which beams passed through
    clamp_probability: float = 0.97  # how sure a cell can become, of either
