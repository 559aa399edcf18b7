"""Settings of localisation in a finished map."""

from __future__ import annotations

from dataclasses import dataclass

from mapmyworld.config.ranges import Count, FromZero, Positive, Share


@dataclass(frozen=True, slots=True)
class LocalisationConfig:
    """Settings of localisation in a finished map."""

    spacing: Positive = 0.5  # m between the map's scans that new ones are matched with
    targets: Count = 4  # scans of the map that each new one is matched with
    fit_distance: Positive = 0.15  # m from a mapped surface within which a point is explained
    agreement: Share = 0.6  # explained points over those and contradicted ones, else it is lost
    coverage: Share = 0.2  # share of all points that must be explained, else it is dead reckoning
    reckon_distance: FromZero = 3.0  # m that odometry is followed where the map does not help
    field_points: Count = 80  # points of a scan that are compared with the map
    step_distance: Positive = 0.1  # m of motion between two images that are compared
    step_angle: Positive = 0.1  # rad of rotation between two images that are compared
    confirm_distance: FromZero = 5.0  # m of motion after which the whole map is searched again
    position_floor: Positive = 0.01  # m, no pose is more certain
    heading_floor: Positive = 0.003  # rad, no heading is more certain
