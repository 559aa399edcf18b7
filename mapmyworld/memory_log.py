"""A log of messages that are at hand already: from a notebook, a test, or another program."""

from __future__ import annotations

import hashlib
from collections.abc import Collection, Iterator, Sequence
from functools import partial

import numpy as np

from mapmyworld.types import LogInfo, Message, RawMessage, topics_of


class MemoryLog:
    """Messages as (topic, message, log time in nanoseconds) in any order, as a `LogSource`."""

    def __init__(self, messages: Sequence[tuple[str, Message, int]]) -> None:
        self._messages = sorted(messages, key=lambda item: item[2])

    def info(self) -> LogInfo:
        topics = topics_of(self.messages(), lambda raw: str(raw.kind), "memory")
        return LogInfo(("memory",), "memory", 0, topics)

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

    def let_go(self) -> None:
        """Keeps the messages: there is no file to read them from."""


def _itself(message: Message) -> Message:
    return message
