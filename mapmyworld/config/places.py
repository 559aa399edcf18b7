"""Settings of place recognition and proximity."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class PlacesConfig:
    pass
