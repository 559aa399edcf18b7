"""Several logs of one drive as one: split bags, or bags recorded side by side."""

from __future__ import annotations

import hashlib
import heapq
from collections.abc import Collection, Iterator, Sequence

from mapmyworld.types import LogInfo, LogSource, RawMessage, TopicInfo


class MergedLog:
    """A LogSource over several, in log-time order, ties in the order in which they were given."""

    def __init__(self, sources: Sequence[LogSource], problems: Sequence[str] = ()) -> None:
        """`problems` tells of parts that could not be opened."""
        self.sources = tuple(sources)
        self.problems = tuple(problems)

    def info(self) -> LogInfo:
        infos = [source.info() for source in self.sources]
        filled = [info for info in infos if info.message_count] or infos
        return LogInfo(
            tuple(path for info in infos for path in info.paths),
            " + ".join(dict.fromkeys(info.container for info in infos)),
            sum(info.size_bytes for info in infos),
            sum(info.message_count for info in infos),
            min(info.start_ns for info in filled),
            max(info.end_ns for info in filled),
            merged_topics(topic for info in infos for topic in info.topics),
            tuple(dict.fromkeys(detail for info in infos for detail in info.details)),
            (*self.problems, *(problem for info in infos for problem in info.problems)),
        )

    def content_hash(self) -> str:
        digest = hashlib.sha256()
        for source in self.sources:
            digest.update(source.content_hash().encode())
        return digest.hexdigest()

    def messages(self, topics: Collection[str] | None = None) -> Iterator[RawMessage]:
        streams = [source.messages(topics) for source in self.sources]
        return heapq.merge(*streams, key=lambda message: message.log_time_ns)

    def losses(self) -> tuple[str, ...]:
        return (*self.problems, *(loss for source in self.sources for loss in source.losses()))


def merged_topics(topics: Iterator[TopicInfo]) -> tuple[TopicInfo, ...]:
    """One entry a topic and type, by name; counts added up where all are known."""
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
        a.count + b.count if a.count >= 0 and b.count >= 0 else -1,
        min(firsts, default=None),
        max(lasts, default=None),
    )
