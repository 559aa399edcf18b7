"""What every reader of logs must keep: a new one is tested by naming one log of its kind."""

from __future__ import annotations

from collections import Counter
from dataclasses import fields, is_dataclass
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
from log_builders import allowed

from formats.converting import convert_log
from formats.logs import open_log
from mapmyworld.types import LogSource, MessageKind, RawMessage


def check_laws(path: Path, scratch: Path) -> None:
    """Raises AssertionError at the first law that the log at `path` breaks."""
    log = open_log([path])
    messages = list(log.messages())
    assert messages, "a log to test a reader with has messages"
    _in_order_and_again(log, messages)
    _reported_beforehand(log, messages)
    assert log.content_hash() == open_log([path]).content_hash()
    assert log.info().problems == ()
    log.let_go()
    assert [identity(message) for message in log.messages()] == [identity(m) for m in messages]
    assert log.info() == open_log([path]).info()
    converted = scratch / "converted.mcap"
    convert_log(log, converted, overwrite=True)
    for ours, theirs in zip(messages, open_log([converted]).messages(), strict=True):
        assert identity(ours) == identity(theirs)
        said, read = contents(ours.decode()), contents(theirs.decode())
        other = [name for name in said if said[name] != read.get(name)]
        assert not other, f"{ours.topic}: {other} are not what a ROS message of this type can hold"


def _in_order_and_again(log: LogSource, messages: list[RawMessage]) -> None:
    assert all(a.log_time_ns <= b.log_time_ns for a, b in pairwise(messages))
    every = [identity(message) for message in messages]
    assert [identity(message) for message in log.messages()] == every
    for topic in {message.topic for message in messages}:
        chosen = [identity(message) for message in log.messages([topic])]
        assert chosen == [item for item in every if item[0] == topic]
    assert list(log.messages([])) == []


def _reported_beforehand(log: LogSource, messages: list[RawMessage]) -> None:
    info = log.info()
    counts = Counter((message.topic, message.kind) for message in messages)
    assert {(t.topic, t.kind): t.count for t in info.topics} == counts
    assert info.message_count == len(messages)
    assert info.start_ns == messages[0].log_time_ns
    assert info.end_ns == messages[-1].log_time_ns
    for message in messages:
        stamp_ns = getattr(message.decode(), "stamp_ns", None)
        assert message.stamp_ns in (None, stamp_ns)


def check_cut(log: Path, file: Path, whole: bytes, cut: int) -> None:
    """Of a log of which `file` is cut, what precedes is read, or refused; nothing is made up."""
    file.write_bytes(whole)
    known = _recorded(log)
    file.write_bytes(whole[:cut])
    found = allowed(lambda: _recorded(log), str(log))
    assert found is None or found <= known, f"cut at {cut}: {found - known} are not in the log"


def _recorded(path: Path) -> Counter[tuple[tuple[str, str, int], str]]:
    """Messages but those that a reader derives from the others, with what they decode to.

    Those that raise LogError instead are left out.
    """
    log = open_log([path])
    log.info()
    messages = [m for m in log.messages() if m.kind not in _DERIVED]
    decoded = [(identity(m), allowed(m.decode)) for m in messages]
    return Counter((which, repr(contents(value))) for which, value in decoded if value is not None)


def identity(message: RawMessage) -> tuple[str, str, int]:
    return message.topic, str(message.kind), message.log_time_ns


def contents(value: Any) -> Any:
    """A message as values that compare; pictures by their pixels, not by how they were packed."""
    if is_dataclass(value):
        names = [item.name for item in fields(value) if item.name not in _PACKING]
        return {name: contents(getattr(value, name)) for name in names}
    if isinstance(value, np.ndarray):
        return value.shape, str(value.dtype), value.tobytes()
    if isinstance(value, tuple):
        return [contents(item) for item in value]
    return contents(value()) if callable(value) else value


_PACKING = {"encoded", "encoding", "width", "height"}
_DERIVED = {MessageKind.CAMERA_INFO, MessageKind.TRANSFORMS}
