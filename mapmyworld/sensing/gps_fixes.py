"""GPS fixes: kept with the nodes, no part in any decision."""

from __future__ import annotations

import math

from mapmyworld.errors import LogError
from mapmyworld.sensing.plan import Draft
from mapmyworld.types import GpsMessage, MessageKind, RawMessage

_FIX_NS = 1_000_000_000  # after which a fix indicates nothing about where the robot is


def choose_gps(draft: Draft) -> str:
    """The topic of the receiver with the most fixes; empty without any."""
    receivers = draft.survey.of_kind(MessageKind.GPS)
    if not receivers:
        return ""
    best = max(receivers, key=lambda stream: (stream.count, stream.topic))
    draft.decide("gps", best.topic, f"{best.count} fixes, stored with the nodes, not used to map")
    return best.topic


class GpsFixes:
    """The newest fix."""

    def __init__(self) -> None:
        self._fix: GpsMessage | None = None

    def add(self, raw: RawMessage) -> None:
        """Takes a message; a damaged one, or one without a fix, is passed over."""
        try:
            message = raw.decode()
        except LogError:
            return
        if isinstance(message, GpsMessage) and math.isfinite(message.latitude + message.longitude):
            self._fix = message

    def fix_at(self, stamp_ns: int) -> GpsMessage | None:
        """The newest fix, unless it is too far from a stamp."""
        fix = self._fix
        return fix if fix is not None and abs(stamp_ns - fix.stamp_ns) <= _FIX_NS else None
