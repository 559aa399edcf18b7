"""Settings of place recognition and proximity."""

from __future__ import annotations

from dataclasses import dataclass

from mapmyworld.config.ranges import Positive, Step, Whole


@dataclass(frozen=True, slots=True)
class PlacesConfig:
    """Settings of recognising places."""

    vocabulary: str = ""  # file of visual words, or a map that has some; empty = learned anew
    laser_spacing: Step = 1.0  # m of path between two scans that look for known places nearby
    laser_far_spacing: Step = 2.0  # m of path between two scans that look as far as drift goes
    laser_submap: Positive = 5.0  # m of path to each side that a submap covers
    laser_revisits: Whole = 3  # earlier revisits that each scan is compared with, at most
