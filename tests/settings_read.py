"""Which settings each stage of a build reads, recorded where they are read."""

from __future__ import annotations

import sys
from collections import defaultdict
from collections.abc import Callable, Collection, Iterator
from dataclasses import fields
from typing import Any

import pytest

from formats.database import MemoryMap
from mapmyworld.api import Silent
from mapmyworld.config import Config
from mapmyworld.config.settings import list_settings
from mapmyworld.pipeline import build_map
from mapmyworld.stages.record import StageRecord
from mapmyworld.types import LogInfo, LogSource, RawMessage


class Beginning:
    """The first seconds of a log."""

    def __init__(self, log: LogSource, seconds: float) -> None:
        self._log, self._end_ns = log, log.info().start_ns + int(seconds * 1e9)

    def info(self) -> LogInfo:
        return self._log.info()

    def content_hash(self) -> str:
        return self._log.content_hash()

    def messages(self, topics: Collection[str] | None = None) -> Iterator[RawMessage]:
        return (m for m in self._log.messages(topics) if m.log_time_ns < self._end_ns)

    def let_go(self) -> None:
        self._log.let_go()


def settings_read(log: LogSource, config: Config, method: str = "graph") -> dict[str, set[str]]:
    """Stage -> names of the settings that it read while the map of a log was built in memory."""
    found: dict[str, set[str]] = defaultdict(set)
    given = {setting.name: setting.value for setting in list_settings(config)}
    at_work = [""]

    def recorder(prefix: str) -> Callable[[Any, str], Any]:
        def read(section: Any, name: str) -> Any:
            value, full = object.__getattribute__(section, name), prefix + name
            copied = sys._getframe(1).f_code.co_name in ("replace", "_replace")
            # What a stage has changed in a copy of its own is no setting any more.
            if at_work[0] and full in given and not copied and value == given[full]:
                found[at_work[0]].add(full)
            return value

        return read

    run = StageRecord.run

    def watched(
        record: StageRecord, stage: str, inputs: tuple[Any, ...], work: Callable[[], None]
    ) -> None:
        def watched_work() -> None:
            at_work[0] = stage
            try:
                work()
            finally:
                at_work[0] = ""

        run(record, stage, inputs, watched_work)

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(Config, "__getattribute__", recorder(""))
        for item in fields(Config):
            section = type(object.__getattribute__(config, item.name))
            if section.__module__.startswith("mapmyworld.config"):
                patch.setattr(section, "__getattribute__", recorder(f"{item.name}."))
        patch.setattr(StageRecord, "run", watched)
        build_map(log, MemoryMap(), config, Silent(), method=method)
    return found
