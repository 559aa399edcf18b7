"""The recorded log again, with the transform that moves its odometry into the finished map."""

from __future__ import annotations

import heapq
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from formats.converting import Copier
from formats.foxglove import foxglove_messages as fox
from formats.foxglove.map_file import MAP, Event, FoxgloveMap, map_events, write_layout
from formats.foxglove.sink import FoxgloveSink
from formats.recording_files import LogWriter
from formats.recording_sinks import McapSink
from mapmyworld.errors import LogError
from mapmyworld.types import (
    LogSource,
    MessageKind,
    OdometryMessage,
    RawMessage,
    TransformsMessage,
    TransformStamped,
)

Floats = NDArray[np.float64]
_SAMPLE = 2000  # messages that show the log's frames and clock
_TOPIC = "/map/tf"
_ODOM = "odom"


@dataclass(frozen=True, slots=True, eq=False)
class _Frames:
    """What the log calls its frames, and what its own transforms already say."""

    odom: str
    base: str
    reported: bool
    """Whether the log's tf leads from odom to base."""
    behind_ns: int
    """Log time less header stamp, at least."""
    first: Mapping[str, TransformStamped]
    """Frame -> the first transform that the log's tf holds of it; valid from the log's start on."""


def write_replay(
    path: Path, shown: FoxgloveMap, log: LogSource, odom_from_base: Floats | None
) -> tuple[list[Path], tuple[str, ...]]:
    """The whole log with `map -> odom` added; what was written, and what could not be.

    `odom_from_base` (F, 4, 4) is the recorded odometry of the tracked frames; without it the
    robot's own pose is written instead.
    """
    frames = _frames_of(log, shown.base_frame)
    with LogWriter(path, overwrite=True) as writer:
        assert isinstance(writer.sink, McapSink)
        copier = Copier(writer)
        replay = _Replay(log, frames, writer, FoxgloveSink(writer.sink), copier)
        replay.run(_ours(shown, frames, odom_from_base, log))
    return [path, write_layout(path)], (*log.losses(), *copier.losses())


def _ours(
    shown: FoxgloveMap, frames: _Frames, odom_from_base: Floats | None, log: LogSource
) -> list[Event]:
    """Our messages in order of log time, from the log's start to its end."""
    info = log.info()
    stamps = shown.stamps_ns + frames.behind_ns
    rows = []
    for k, (stamp, time_ns) in enumerate(
        zip(shown.stamps_ns.tolist(), stamps.tolist(), strict=True)
    ):
        for parent, child, pose in _links(shown, frames, odom_from_base, k):
            rows.append((time_ns, stamp, parent, child, pose))
    per_frame = len(rows) // max(len(stamps), 1)
    if rows:
        early = min(info.start_ns, rows[0][0])
        first = [(early, early - frames.behind_ns, *row[2:]) for row in rows[:per_frame]]
        late = max(info.end_ns, rows[-1][0])
        last = [(late, late - frames.behind_ns, *row[2:]) for row in rows[-per_frame:]]
        rows = [*first, *rows, *last]
    found = [
        (time_ns, _TOPIC, fox.transform(stamp, parent, child, pose))
        for time_ns, stamp, parent, child, pose in rows
    ]
    start = found[0][0] if found else info.start_ns
    at = start - frames.behind_ns
    early_frames = [
        (start, _TOPIC, fox.transform(at, t.parent, t.child, t.parent_from_child))
        for t in frames.first.values()
        if _is_kept(t, frames)
    ]
    fixed = [(start, topic, message) for _, topic, message in map_events(shown) if topic != "/tf"]
    return [*found[:per_frame], *early_frames, *fixed, *found[per_frame:]]


def _links(
    shown: FoxgloveMap, frames: _Frames, odom_from_base: Floats | None, k: int
) -> list[tuple[str, str, Floats]]:
    pose = shown.map_from_base[k]
    if odom_from_base is None:
        return [(MAP, frames.base, pose)]
    links = [(MAP, frames.odom, pose @ np.linalg.inv(odom_from_base[k]))]
    return links if frames.reported else [*links, (frames.odom, frames.base, odom_from_base[k])]


def _frames_of(log: LogSource, base: str) -> _Frames:
    """From the first messages of odometry and tf."""
    kinds = {MessageKind.ODOMETRY, MessageKind.TRANSFORMS}
    topics = {topic.topic for topic in log.info().topics if topic.kind in kinds}
    odom, parents, delays = "", dict[str, str](), list[int]()
    first: dict[str, TransformStamped] = {}
    for count, raw in enumerate(log.messages(topics)):
        if count >= _SAMPLE:
            break
        if raw.stamp_ns:
            delays.append(raw.log_time_ns - raw.stamp_ns)
        message = _decoded(raw)
        if isinstance(message, OdometryMessage) and message.child_frame_id.lstrip("/") == base:
            odom = odom or message.frame_id.lstrip("/")
        elif isinstance(message, TransformsMessage):
            parents |= {t.child.lstrip("/"): t.parent.lstrip("/") for t in message.transforms}
            if not message.static:
                first = {t.child: t for t in message.transforms} | first
    frame = base
    chain = [frame]
    while (frame := parents.get(frame, "")) and frame not in chain and frame != MAP:
        chain.append(frame)
    odom = odom or (chain[-1] if len(chain) > 1 else _ODOM)
    return _Frames(odom, base, odom in chain[1:], min(delays, default=0), first)


def _decoded(raw: RawMessage) -> Any:
    try:
        return raw.decode()
    except LogError:
        return None


Act = tuple[int, int, Callable[[], None]]
"""Log time, rank among equals, and what to do."""


@dataclass(frozen=True, slots=True, eq=False)
class _Replay:
    """Our messages and the log's in one order; ours come first where times are equal."""

    log: LogSource
    frames: _Frames
    writer: LogWriter
    sink: FoxgloveSink
    copier: Copier

    def run(self, ours: Sequence[Event]) -> None:
        kinds = {t.topic: t.kind for t in self.log.info().topics}
        tf = frozenset(name for name, kind in kinds.items() if kind is MessageKind.TRANSFORMS)
        others = frozenset(kinds) - tf
        streams = [self._ours(ours)]
        streams += [self._transforms(tf)] if tf else []
        streams += [self._copies(others)] if others else []
        for _, _, act in heapq.merge(*streams, key=lambda item: item[:2]):
            act()

    def _ours(self, events: Sequence[Event]) -> Iterator[Act]:
        for time_ns, topic, message in events:
            yield time_ns, 0, partial(self.sink.write, topic, message, time_ns)

    def _transforms(self, topics: frozenset[str]) -> Iterator[Act]:
        for raw in self.log.messages(topics):
            yield raw.log_time_ns, 1, partial(_write_tf, raw, self.frames, self.writer)

    def _copies(self, topics: frozenset[str]) -> Iterator[Act]:
        for time_ns, _, write in self.copier.writes(self.log, topics):
            yield time_ns, 2, partial(write, time_ns)


def _write_tf(raw: RawMessage, frames: _Frames, writer: LogWriter) -> None:
    """The log's own transforms, but for those that a localiser's map would contradict ours by."""
    message = _decoded(raw)
    if not isinstance(message, TransformsMessage):
        return
    kept = tuple(t for t in message.transforms if _is_kept(t, frames))
    if kept:
        writer.write(raw.topic, replace(message, transforms=kept), raw.log_time_ns)


def _is_kept(transform: TransformStamped, frames: _Frames) -> bool:
    """Not where it would contradict ours."""
    return transform.child.lstrip("/") != frames.odom and transform.parent.lstrip("/") != MAP
