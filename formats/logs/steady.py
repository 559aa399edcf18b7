"""A log that must stay as it is while a map is made of it."""

from __future__ import annotations

from collections.abc import Collection, Iterator
from pathlib import Path

from mapmyworld.errors import LogError
from mapmyworld.types import LogInfo, LogSource, RawMessage

Look = tuple[int, int, int]


class SteadyLog:
    """The same LogSource; a pass over it fails where its files were changed since the first look.

    A map records of which bytes it was made: a file that is copied, cut or replaced meanwhile would
    give a map of something else.
    """

    def __init__(self, log: LogSource) -> None:
        self._log = log
        self._looks = {path: _look(Path(path)) for path in log.info().paths}

    def info(self) -> LogInfo:
        return self._log.info()

    def content_hash(self) -> str:
        return self._log.content_hash()

    def let_go(self) -> None:
        self._log.let_go()

    def messages(self, topics: Collection[str] | None = None) -> Iterator[RawMessage]:
        """Those of the log; raises `LogError` where one of its files was changed meanwhile."""
        yield from self._log.messages(topics)
        for path, look in self._looks.items():
            if _look(Path(path)) != look:
                raise LogError(
                    f"{path}: was changed or removed while it was read: give the same command "
                    "again when it is complete"
                )


def _look(path: Path) -> Look | None:
    """Which file it is, how long, and when it was written; None where there is none."""
    try:
        found = path.stat()
    except OSError:
        return None
    return found.st_ino, found.st_size, found.st_mtime_ns
