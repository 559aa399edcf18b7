"""Settings of laser odometry and of joint alignment."""

from __future__ import annotations

from dataclasses import dataclass

from mapmyworld.config.ranges import Count, FromZero, Positive, Share, Whole


@dataclass(frozen=True, slots=True)
class OdometryConfig:
    """Settings of tracking by laser, and of aligning all scans in the end."""

    keyframe_distance: FromZero = 0.15  # m of motion after which a scan or image is a keyframe
    keyframe_angle: FromZero = 0.2  # rad of rotation after which a scan or image is a keyframe
    relative_noise: Positive = 0.2  # m per m and rad per rad, noise of recorded motion at first
    absolute_noise: Positive = 0.02  # m, and half as many rad, noise of any recorded motion
    contradiction: Positive = 4.0  # sigmas between odometry and match at which odometry is ignored
    least_overlap: Share = 0.55  # share of a scan that the submap explains, below which it searches
    search_distance: FromZero = 0.8  # m to each side that such a search covers
    search_angle: FromZero = 1.6  # rad to each side that such a search covers
    refine: bool = True  # whether all scans are aligned with each other after the graph is solved
    refine_distance: Positive = 0.3  # m of motion between scans that are aligned jointly in the end
    refine_angle: Positive = 0.3  # rad of rotation between scans that are aligned jointly
    refine_radius: Positive = 4.0  # m within which other visits' scans are aligned with each
    refine_revisits: Whole = 4  # revisits that each scan is aligned with, at most
    refine_references: Count = 2  # revisits of a place that shape the map; later ones follow
