"""Settings of the grid; those of clouds and meshes stand with the images they are made of."""

from __future__ import annotations

from dataclasses import dataclass

from mapmyworld.config.ranges import FromZero, Likely, Positive, Unlikely


@dataclass(frozen=True, slots=True)
class MappingConfig:
    """Settings of the occupancy grid."""

    resolution: Positive = 0.05  # m, side of a cell of the grid
    range_max: Positive = 30.0  # m, beams are drawn up to here
    missing_range: FromZero = 0.0  # m that a beam without return is taken to have passed freely
    hit_probability: Likely = 0.7  # of being occupied, for a cell in which a beam ended
    miss_probability: Unlikely = 0.35  # of being occupied, for a cell which beams passed through
    clamp_probability: Likely = 0.97  # how confident a cell can become, of either
