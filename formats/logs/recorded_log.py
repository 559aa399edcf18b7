"""A container of serialised messages as a LogSource: info, and lazily decoded messages."""

from __future__ import annotations

from collections.abc import Collection, Iterable, Iterator

from formats.bounds import LATEST_NS
from formats.logs.block_files import BlockFile
from formats.logs.channels import Record
from formats.logs.clock_steps import moved_stamps
from formats.logs.decoding import decoder_for
from formats.logs.files import hash_files
from mapmyworld.types import LogInfo, RawMessage, TopicInfo


class RecordedLog:
    """A LogSource over one bag or MCAP file."""

    def __init__(self, container: BlockFile) -> None:
        self.container = container

    def info(self) -> LogInfo:
        index = self.container.index()
        topics = merged_topics(self._topic(key) for key in index.channels)
        start, end = index.span_ns()
        return LogInfo(
            (str(self.container.path),),
            self.container.name,
            self.container.path.stat().st_size,
            sum(index.counts.values()),
            start,
            end,
            topics,
            tuple(index.details),
            tuple(dict.fromkeys(index.problems)),
        )

    def content_hash(self) -> str:
        return hash_files([self.container.path])

    def losses(self) -> tuple[str, ...]:
        return tuple(self.container.index().problems)

    def records(self, topics: Collection[str] | None = None) -> Iterator[Record]:
        """Messages as recorded, undecoded."""
        for time, channel, data in self.container.records(topics):
            yield min(max(time, 0), LATEST_NS), channel, data

    def messages(self, topics: Collection[str] | None = None) -> Iterator[RawMessage]:
        for record, mended in self.mended_records(topics):
            yield self._message(record) if mended is None else mended

    def mended_records(
        self, topics: Collection[str] | None = None
    ) -> Iterator[tuple[Record, RawMessage | None]]:
        """Messages as recorded; beside those whose stamps a set clock spoilt, as they should be."""
        self.container.index()  # with which the step is known
        step = self.container.clock_step
        for record in self.records(topics):
            raw = None if step is None else self._message(record)
            moved = None if raw is None or step is None else moved_stamps(raw, step.back_ns)
            yield record, None if moved is raw else moved

    def _message(self, record: Record) -> RawMessage:
        time, channel, data = record
        return decoder_for(channel).message(data, time)

    def _topic(self, key: int) -> TopicInfo:
        index = self.container.index()
        channel, count = index.channels[key], index.counts.get(key, 0)
        first, last = index.span_ns(key) if count else (None, None)
        kind = decoder_for(channel).kind
        return TopicInfo(
            channel.topic, channel.type_name, kind, channel.encoding, count, first, last
        )


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
