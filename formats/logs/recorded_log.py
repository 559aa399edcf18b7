"""A container of serialised messages as a LogSource: info, and lazily decoded messages."""

from __future__ import annotations

from collections.abc import Collection, Iterator
from functools import partial
from itertools import pairwise

from formats.bounds import LATEST_NS
from formats.logs.channels import Block, Channel, Container, Record
from formats.logs.clock_steps import LEAST_STEP_NS
from formats.logs.decoding import ChannelDecoder, decoder_for
from formats.logs.files import hash_files
from formats.logs.moved_stamps import moved_stamps
from formats.logs.topics import merged_topics
from mapmyworld.types import LogInfo, RawMessage, TopicInfo


def _place(block: Block) -> int:
    return block.offset


class RecordedLog:
    """A LogSource over one bag or MCAP file."""

    def __init__(self, container: Container) -> None:
        self.container = container
        self._decoders: dict[Channel, ChannelDecoder] = {}
        self._hash: str | None = None

    def info(self) -> LogInfo:
        index = self.container.index()
        topics = merged_topics(self._topic(key) for key in index.channels)
        start, end = index.span_ns()
        return LogInfo(
            tuple(str(path) for path in self.container.files()),
            self.container.name,
            sum(path.stat().st_size for path in self.container.files()),
            sum(index.counts.values()),
            start,
            end,
            topics,
            tuple(index.details),
            tuple(dict.fromkeys([*index.problems, *self.container.losses()])),
        )

    def content_hash(self) -> str:
        if self._hash is None:
            self._hash = hash_files(self.container.files())
        return self._hash

    def losses(self) -> tuple[str, ...]:
        return self.container.losses()

    def records(self, topics: Collection[str] | None = None) -> Iterator[Record]:
        """Messages as recorded, undecoded."""
        for time, channel, data in self.container.records(topics):
            yield min(max(time, 0), LATEST_NS), channel, data

    def messages(self, topics: Collection[str] | None = None) -> Iterator[RawMessage]:
        self.container.index()  # some know the step from then on
        step = self.container.clock_step
        raws = map(self._message, self.container.records(topics))
        yield from raws if step is None else (moved_stamps(raw, step.back_ns) for raw in raws)

    def mended_records(
        self, topics: Collection[str] | None = None
    ) -> Iterator[tuple[Record, RawMessage | None]]:
        """Messages as recorded; beside those whose stamps a set clock spoilt, as they should be."""
        for record in self.records(topics):
            step = self.container.clock_step
            if step is None:
                yield record, None
                continue
            raw = self._message(record)
            moved = moved_stamps(raw, step.back_ns)
            yield record, None if moved is raw else moved

    def find_clock_step(self) -> None:
        """Reads all of a log in which the clock may have been set back, to know whether it was.

        It shows in blocks that begin before those in front of them end, and within one alone. Rows
        of a database stand in none: their step is known with the index.
        """
        blocks = sorted((b for b in self.container.index().blocks if b.offset), key=_place)
        late = any(b.end_ns - after.start_ns > LEAST_STEP_NS for b, after in pairwise(blocks))
        if self.container.clock_step is None and (late or len(blocks) == 1):
            for _ in self.container.records():
                pass

    def _message(self, record: Record) -> RawMessage:
        time, channel, data = record
        decoder = self._decoders.get(channel)
        if decoder is None:
            decoder = self._decoders[channel] = decoder_for(channel)
        return RawMessage(
            channel.topic,
            decoder.kind,
            time if 0 <= time <= LATEST_NS else min(max(time, 0), LATEST_NS),
            decoder.stamp(data),
            partial(decoder.decode, data, time),
        )

    def _topic(self, key: int) -> TopicInfo:
        index = self.container.index()
        channel, count = index.channels[key], index.counts.get(key, 0)
        first, last = index.span_ns(key) if count else (None, None)
        kind = self._decoder(channel).kind
        return TopicInfo(
            channel.topic, channel.type_name, kind, channel.encoding, count, first, last
        )

    def _decoder(self, channel: Channel) -> ChannelDecoder:
        if channel not in self._decoders:
            self._decoders[channel] = decoder_for(channel)
        return self._decoders[channel]
