"""A log of messages that are at hand already: from a notebook, a test, or another program."""

from __future__ import annotations

import hashlib
from collections.abc import Collection, Iterator, Sequence
from functools import partial

import numpy as np

from mapmyworld.types import LogInfo, Message, RawMessage, TopicInfo


class MemoryLog:
    """Messages as (topic, message, log time in nanoseconds) in any order, as a `LogSource`."""

    def __init__(self, messages: Sequence[tuple[str, Message, int]]) -> None:
        self._messages = sorted(messages, key=lambda item: item[2])

    def info(self) -> LogInfo:
        times = [time for _, _, time in self._messages] or [0]
        topics = dict.fromkeys(topic for topic, _, _ in self._messages)
        return LogInfo(
            paths=("memory",),
            container="memory",
            size_bytes=0,
            message_count=len(self._messages),
            start_ns=times[0],
            end_ns=times[-1],
            topics=tuple(self._topic(name) for name in sorted(topics)),
        )

    def _topic(self, name: str) -> TopicInfo:
        mine = [(message, time) for topic, message, time in self._messages if topic == name]
        kind = mine[0][0].kind
        return TopicInfo(name, str(kind), kind, "memory", len(mine), mine[0][1], mine[-1][1])

    def content_hash(self) -> str:
        """Of times, topics and every array that is at hand; images by what they were made of."""
        digest = hashlib.sha256()
        for topic, message, time in self._messages:
            digest.update(f"{topic} {time} {type(message).__name__}".encode())
            for name in message.__dataclass_fields__:
                value = getattr(message, name)
                if isinstance(value, np.ndarray):
                    digest.update(np.ascontiguousarray(value).tobytes())
                elif isinstance(value, bytes | str | int | float):
                    digest.update(repr(value).encode())
        return digest.hexdigest()

    def messages(self, topics: Collection[str] | None = None) -> Iterator[RawMessage]:
        for topic, message, time in self._messages:
            if topics is None or topic in topics:
                decode = partial(_itself, message)
                yield RawMessage(topic, message.kind, time, message.stamp_ns, decode)

    def losses(self) -> tuple[str, ...]:
        return ()


def _itself(message: Message) -> Message:
    return message
