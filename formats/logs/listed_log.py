"""Logs whose messages are listed in memory, to be decoded when asked for: text and its images."""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterator, Mapping
from pathlib import Path
from typing import ClassVar

from formats.logs.files import hash_files
from formats.ros_messages import TYPES
from mapmyworld.types import LogInfo, RawMessage, TopicInfo, topics_of


class ListedLog:
    """A LogSource over a file or folder that is read when it is opened, and small."""

    container = ""
    encoding = ""
    type_names: ClassVar[Mapping[str, str]] = {}
    """Of topics, as ROS 2 writes them, where they are not those of their kind."""

    def __init__(self, path: Path) -> None:
        self.path = path
        self._topics: tuple[TopicInfo, ...] | None = None
        self._list()

    def _list(self) -> Callable[[], Iterator[RawMessage]]:
        self.problems: list[str] = []
        self.details: list[tuple[str, str]] = []
        self.doubts: dict[str, str] = {}
        """Topic -> what is doubtful of it, though every line is sound."""
        listed = self._read()
        self._listed: Callable[[], Iterator[RawMessage]] | None = listed
        return listed

    def _read(self) -> Callable[[], Iterator[RawMessage]]:
        """What gives all messages by log time, each time it is called."""
        raise NotImplementedError

    def _files(self) -> list[Path]:
        return [self.path]

    def info(self) -> LogInfo:
        if self._topics is None:
            named = self.type_names
            messages = self.messages()  # looked at once; none is decoded
            self._topics = topics_of(
                messages, lambda raw: named.get(raw.topic, TYPES[raw.kind]), self.encoding
            )
        return LogInfo(
            (str(self.path),),
            self.container,
            sum(path.stat().st_size for path in self._files() if path.is_file()),
            self._topics,
            tuple(self.details),
            tuple(self.problems),
            tuple(sorted(self.doubts.items())),
        )

    def content_hash(self) -> str:
        return hash_files(self._files())

    def messages(self, topics: Collection[str] | None = None) -> Iterator[RawMessage]:
        listed = self._listed or self._list()
        return (raw for raw in listed() if topics is None or raw.topic in topics)

    def let_go(self) -> None:
        self._listed = None
