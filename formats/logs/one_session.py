"""Whether several logs can be parts of one session: what is no such part would be mixed into it."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import combinations, pairwise

from mapmyworld.errors import LogError
from mapmyworld.types import LogInfo, LogSource, MessageKind

_SENSORS = {
    MessageKind.LASER_SCAN,
    MessageKind.POINT_CLOUD,
    MessageKind.IMAGE,
    MessageKind.ODOMETRY,
}
_TOGETHER = 0.1  # share of the shorter one for which both record a topic: parts touch at their ends
_BUFFERED_NS = 10**9  # that recorders write late, and may so seem to record together
_APART_NS = 3600 * 10**9  # between the parts of one recording; a robot is elsewhere after longer
_WAYS = "map each with `mapmyworld batch`; join maps with `build --append MAP` or `merge`"

Spans = dict[str, tuple[int, int]]
"""Topic -> first and last log time."""


def require_one_session(sources: Sequence[LogSource]) -> None:
    """Raises `LogError` where two of the logs overlap in time, lie apart, or are of two robots.

    Bags recorded side by side have other topics each; parts of a split one follow each other.
    """
    infos = sorted((source.info() for source in sources), key=lambda info: info.start_ns)
    logs = [(info.paths[0], _spans(info)) for info in infos]
    for pairs, fault in ((combinations(logs, 2), _overlap), (pairwise(logs), _gap)):
        for (a, spans_a), (b, spans_b) in pairs:
            if why := fault(spans_a, spans_b):
                raise LogError(f"{a} and {b} are not one session ({why}): {_WAYS}")


def _spans(info: LogInfo) -> Spans:
    return {
        t.topic: (t.first_ns, t.last_ns)
        for t in info.topics
        if t.kind in _SENSORS and t.first_ns is not None and t.last_ns is not None
        if t.last_ns > t.first_ns  # else no clock indicates when
    }


def _overlap(a: Spans, b: Spans) -> str:
    for topic in sorted(a.keys() & b.keys()):
        (first_a, last_a), (first_b, last_b) = a[topic], b[topic]
        together = min(last_a, last_b) - max(first_a, first_b)
        least = _TOGETHER * min(last_a - first_a, last_b - first_b)
        if together > max(least, _BUFFERED_NS):
            return f"both record {topic} for {together * 1e-9:.0f} s at the same time"
    return ""


def _gap(before: Spans, after: Spans) -> str:
    if not before or not after:
        return ""
    gap_ns = min(first for first, _ in after.values()) - max(last for _, last in before.values())
    if gap_ns > _APART_NS:
        return f"{_duration(gap_ns * 1e-9)} lie between them"
    if gap_ns > 0 and not before.keys() & after.keys():
        return "they have no sensor's topic in common"
    return ""


def _duration(seconds: float) -> str:
    for unit, length in (("years", 31_557_600.0), ("days", 86_400.0)):
        if seconds > 2 * length:
            return f"{seconds / length:.0f} {unit}"
    return f"{seconds / 3600:.1f} hours"
