"""Settings of scan matching, PnP and ICP."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class RegistrationConfig:
    pass
