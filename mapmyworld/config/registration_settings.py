"""Settings of scan matching."""

from __future__ import annotations

from dataclasses import dataclass

from mapmyworld.config.ranges import Count, Positive


@dataclass(frozen=True, slots=True)
class RegistrationConfig:
    """Settings of aligning laser scans."""

    point_spacing: Positive = 0.04  # m between neighbouring points of a scan that are matched
    point_count: Count = 220  # points of a scan that are matched, about; more are thinned
    line_radius: Positive = 0.15  # m around a point within which its line is fitted
    range_max: Positive = 40.0  # m, farther returns are not matched
    residual_share: Positive = 0.25  # of the search for a line: so far off a point counts half
    range_sigma: Positive = 0.02  # m, standard deviation of a point about its line
    correlation: Positive = 4.0  # neighbouring points that together count as one
