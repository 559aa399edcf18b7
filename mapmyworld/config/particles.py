"""Settings of grid-based FastSLAM."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class ParticlesConfig:
    pass
