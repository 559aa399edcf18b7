"""Settings of laser and visual odometry."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class OdometryConfig:
    pass
