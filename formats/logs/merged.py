"""Several logs of one session as one: split bags, or bags recorded side by side."""

from __future__ import annotations

import hashlib
import heapq
from collections.abc import Collection, Iterator, Sequence

from formats.logs.channels import Record
from formats.logs.recorded_log import RecordedLog, merged_topics
from mapmyworld.types import LogInfo, LogSource, RawMessage


class MergedLog:
    """A LogSource over several, in log-time order, ties in the order in which they were given."""

    def __init__(self, sources: Sequence[LogSource], problems: Sequence[str] = ()) -> None:
        """`problems` reports parts that could not be opened."""
        nested = [source for source in sources if isinstance(source, MergedLog)]
        flat = [s.sources if isinstance(s, MergedLog) else (s,) for s in sources]
        self.sources: tuple[LogSource, ...] = tuple(source for part in flat for source in part)
        self.problems: tuple[str, ...] = (*problems, *(p for log in nested for p in log.problems))

    def info(self) -> LogInfo:
        infos = [source.info() for source in self.sources]
        return LogInfo(
            tuple(path for info in infos for path in info.paths),
            " + ".join(dict.fromkeys(info.container for info in infos)),
            sum(info.size_bytes for info in infos),
            merged_topics(topic for info in infos for topic in info.topics),
            tuple(dict.fromkeys(detail for info in infos for detail in info.details)),
            (*self.problems, *(problem for info in infos for problem in info.problems)),
            tuple(dict.fromkeys(doubt for info in infos for doubt in info.doubts)),
        )

    def content_hash(self) -> str:
        digest = hashlib.sha256()
        for source in self.sources:
            digest.update(source.content_hash().encode())
        return digest.hexdigest()

    def messages(self, topics: Collection[str] | None = None) -> Iterator[RawMessage]:
        streams = [source.messages(topics) for source in self.sources]
        return heapq.merge(*streams, key=lambda message: message.log_time_ns)

    def mended_records(
        self, topics: Collection[str] | None = None
    ) -> Iterator[tuple[Record, RawMessage | None]]:
        """Messages as recorded, as `RecordedLog` gives them, in the order of `messages`."""
        streams = [s.mended_records(topics) for s in self.sources if isinstance(s, RecordedLog)]
        return heapq.merge(*streams, key=lambda pair: pair[0][0])

    def let_go(self) -> None:
        for source in self.sources:
            source.let_go()
