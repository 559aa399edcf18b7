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
    agreement_found: Share = 0.8  # the same as `agreement`, to call a place recognised
    coverage_found: Share = 0.7  # the same as `coverage`, to call a place recognised
    reckon_distance: FromZero = 3.0  # m that odometry is followed where the map does not help
    particles: Count = 2000  # hypotheses held while the place is unknown, at most
    particles_min: Count = 100  # hypotheses at least
    field_sigma: Positive = 0.1  # m, points about mapped surfaces while hypotheses are weighed
    field_points: Count = 80  # points of a scan that weigh a hypothesis
    points_effective: Positive = 10.0  # of these that count as independent
    step_distance: Positive = 0.1  # m of motion between two weighings
    step_angle: Positive = 0.1  # rad of rotation between two weighings
    certainty: Share = 0.99  # share of the weight that one place must hold to be recognised
    confirm_distance: FromZero = 5.0  # m of motion after which the whole map is searched again
    ambiguity_ratio: Positive = 1.15  # second best agreement to best from which it is believed
    position_floor: Positive = 0.01  # m, no pose is more certain
    heading_floor: Positive = 0.003  # rad, no heading is more certain
