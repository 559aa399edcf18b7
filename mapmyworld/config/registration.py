"""Settings of scan matching, PnP and ICP."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class RegistrationConfig:
    """Settings of aligning two scans."""

    matcher: str = "point_to_line"  # that aligns laser scans: a name of registration/matchers.py
    point_spacing: float = 0.04  # m between neighbouring points of a scan that are matched
    point_count: int = 220  # points of a scan that are matched, about; more are thinned
    line_radius: float = 0.15  # m around a point within which its line is fitted
    range_max: float = 40.0  # m, farther returns are not matched
    residual_scale: float = 0.03  # m, distance from a line at which a point counts half
    range_sigma: float = 0.02  # m, standard deviation of a point about its line
    correlation: float = 2.0  # neighbouring points that together tell as much as one
