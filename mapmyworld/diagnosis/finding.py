"""One thing that was compared, and what to do where it is not as it should be."""

from __future__ import annotations

from dataclasses import dataclass

SENSE_OF_TURNING = "sense of turning"
"""Name of what finds a map to be a mirror image."""


@dataclass(frozen=True, slots=True)
class Finding:
    """What comparing two sensors showed, and what to do about it."""

    name: str
    """What was compared: "odometry scale", ..."""
    value: float
    unit: str
    good: bool
    text: str
    """What was found, and from how much."""
    suggestion: str = ""
    """What to do; empty where all is well."""

    def __post_init__(self) -> None:
        if self.good:
            object.__setattr__(self, "suggestion", "")
