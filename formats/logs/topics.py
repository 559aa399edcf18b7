"""Lists of topics put together."""

from __future__ import annotations

from collections.abc import Iterable

from mapmyworld.types import TopicInfo


def merged_topics(topics: Iterable[TopicInfo]) -> tuple[TopicInfo, ...]:
    """One entry a topic and type, by name; counts added up."""
    found: dict[tuple[str, str], TopicInfo] = {}
    for topic in topics:
        key = (topic.topic, topic.type_name)
        found[key] = _added(found[key], topic) if key in found else topic
    return tuple(found[key] for key in sorted(found))


def _added(a: TopicInfo, b: TopicInfo) -> TopicInfo:
    firsts = [t.first_ns for t in (a, b) if t.first_ns is not None]
    lasts = [t.last_ns for t in (a, b) if t.last_ns is not None]
    return TopicInfo(
        a.topic,
        a.type_name,
        a.kind,
        a.encoding,
        a.count + b.count,
        min(firsts, default=None),
        max(lasts, default=None),
    )
