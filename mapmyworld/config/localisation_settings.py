"""Settings of localisation in a finished map."""

from __future__ import annotations

from dataclasses import dataclass

from mapmyworld.config.ranges import Count, Positive


@dataclass(frozen=True, slots=True)
class LocalisationConfig:
    """Settings of localisation in a finished map."""

    spacing: Positive = 0.5  # m between the map's scans that new ones are matched with
    targets: Count = 4  # scans of the map that each new one is matched with
