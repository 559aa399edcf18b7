"""GPS fixes and readings of the environment: kept with the nodes, no part in any decision."""

from __future__ import annotations

import math
from dataclasses import dataclass, field

from mapmyworld.errors import LogError
from mapmyworld.sensing.plan import Draft
from mapmyworld.types import GpsMessage, MessageKind, Quantity, RawMessage, ReadingMessage

_FIX_NS = 1_000_000_000  # after which a fix indicates nothing about where the robot is
_READING_NS = 10_000_000_000  # after which a reading indicates nothing about the air


def choose_environment_topics(draft: Draft) -> tuple[str, ...]:
    """The GPS receiver with the most fixes, and every reading."""
    receivers = draft.survey.of_kind(MessageKind.GPS)
    readings = [stream.topic for stream in draft.survey.of_kind(MessageKind.READING)]
    if not receivers:
        return tuple(readings)
    best = max(receivers, key=lambda stream: (stream.count, stream.topic))
    draft.decide("gps", best.topic, f"{best.count} fixes, stored with the nodes, not used to map")
    return (best.topic, *readings)


@dataclass(slots=True)
class EnvironmentSensors:
    """The newest fix, and the newest reading of each quantity."""

    _fix: GpsMessage | None = None
    _readings: dict[Quantity, ReadingMessage] = field(default_factory=dict)

    def add(self, raw: RawMessage) -> None:
        """Takes a message of its kinds; damaged ones are passed over."""
        try:
            message = raw.decode()
        except LogError:
            return
        if isinstance(message, GpsMessage):
            if math.isfinite(message.latitude) and math.isfinite(message.longitude):
                self._fix = message
        elif isinstance(message, ReadingMessage) and math.isfinite(message.value):
            self._readings[message.quantity] = message

    def fix_at(self, stamp_ns: int) -> GpsMessage | None:
        """The newest fix, unless it is too far from a stamp."""
        fix = self._fix
        return fix if fix is not None and abs(stamp_ns - fix.stamp_ns) <= _FIX_NS else None

    def readings_at(self, stamp_ns: int) -> tuple[ReadingMessage, ...]:
        """The newest readings, those left out that are too far from a stamp."""
        near = (r for r in self._readings.values() if abs(stamp_ns - r.stamp_ns) <= _READING_NS)
        return tuple(sorted(near, key=lambda reading: reading.quantity))
