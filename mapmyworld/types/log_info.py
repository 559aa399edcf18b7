"""What a log holds, topic by topic, before anything is decoded."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass

from mapmyworld.types.messages import MessageKind, RawMessage


@dataclass(frozen=True, slots=True)
class TopicInfo:
    """What a log indicates about one of its topics."""

    topic: str
    type_name: str
    kind: MessageKind
    encoding: str
    """Serialisation: "cdr", "ros1", "protobuf", "json", "carmen", ..."""
    count: int
    """Messages."""
    first_ns: int | None = None
    last_ns: int | None = None

    @property
    def frequency(self) -> float:
        """Mean rate in Hz; 0 where unknown."""
        if self.count < 2 or self.first_ns is None or self.last_ns is None:
            return 0.0
        span_s = (self.last_ns - self.first_ns) * 1e-9
        return (self.count - 1) / span_s if span_s > 0 else 0.0


def topics_of(
    messages: Iterable[RawMessage], type_of: Callable[[RawMessage], str], encoding: str
) -> tuple[TopicInfo, ...]:
    """By name, the topics of all the messages of a log, which come in its order."""
    firsts: dict[str, RawMessage] = {}
    times: dict[str, list[int]] = {}
    for raw in messages:
        firsts.setdefault(raw.topic, raw)
        times.setdefault(raw.topic, []).append(raw.log_time_ns)
    return tuple(
        TopicInfo(topic, type_of(raw), raw.kind, encoding, len(at := times[topic]), at[0], at[-1])
        for topic, raw in sorted(firsts.items())
    )


@dataclass(frozen=True, slots=True)
class LogInfo:
    """What a log holds, without decoding it."""

    paths: tuple[str, ...]
    container: str
    """"MCAP", "ROS 1 bag", "rosbag2 (sqlite3)", "CARMEN log", "TUM RGB-D folder", ..."""
    size_bytes: int
    topics: tuple[TopicInfo, ...]
    details: tuple[tuple[str, str], ...] = ()
    """Further lines for `inspect log`: library, profile, compression, chunks, ..."""
    problems: tuple[str, ...] = ()
    """What could not be read, and oddities, as far as the log was gone through; one line each."""
    doubts: tuple[tuple[str, str], ...] = ()
    """Topic, and what had to be assumed of it: a loss where that topic is used."""

    @property
    def message_count(self) -> int:
        """Of all topics."""
        return sum(topic.count for topic in self.topics)

    @property
    def start_ns(self) -> int:
        """Log time of the first message; 0 for an empty log."""
        return min((t.first_ns for t in self.topics if t.first_ns is not None), default=0)

    @property
    def end_ns(self) -> int:
        """That of the last."""
        return max((t.last_ns for t in self.topics if t.last_ns is not None), default=0)

    @property
    def duration_s(self) -> float:
        """From the first message to the last."""
        return (self.end_ns - self.start_ns) * 1e-9
