"""The recorded log again, with the transform that moves its odometry into the finished map."""

from __future__ import annotations

import heapq
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from operator import itemgetter
from pathlib import Path
from typing import Any

import numpy as np

from formats.converting import Copier
from formats.foxglove.map_file import MAP, Event, FoxgloveMap, map_events, write_layout
from formats.recording_files import LogWriter
from mapmyworld.errors import LogError
from mapmyworld.geometry import Array
from mapmyworld.types import (
    LogSource,
    MessageKind,
    OdometryMessage,
    RawMessage,
    TransformsMessage,
    TransformStamped,
)

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
    path: Path, shown: FoxgloveMap, log: LogSource, odom_from_base: Array | None
) -> tuple[list[Path], tuple[str, ...]]:
    """The whole log with `map -> odom` added; what was written, and what could not be.

    `odom_from_base` (F, 4, 4) is the recorded odometry of the tracked frames; without it the
    robot's own pose is written instead.
    """
    frames = _frames_of(log, shown.base_frame)
    kinds = {t.topic: t.kind for t in log.info().topics}
    tf = frozenset(name for name, kind in kinds.items() if kind is MessageKind.TRANSFORMS)
    with LogWriter(path, overwrite=True) as writer:
        copier = Copier(writer)
        ours = (
            (at_ns, partial(writer.write, name, message, at_ns))
            for at_ns, name, message in _ours(shown, frames, odom_from_base, log)
        )
        moved = ((r.log_time_ns, partial(_write_tf, r, frames, writer)) for r in log.messages(tf))
        copied = copier.writes(log, frozenset(kinds) - tf)
        others = ((at_ns, partial(write, at_ns)) for at_ns, _, write in copied)
        # Where times are equal, ours come first.
        for _, act in heapq.merge(ours, moved, others, key=itemgetter(0)):
            act()
    return [path, write_layout(path)], (*log.info().problems, *copier.losses())


def _ours(
    shown: FoxgloveMap, frames: _Frames, odom_from_base: Array | None, log: LogSource
) -> list[Event]:
    """Our messages in order of log time, from the log's start to its end."""
    info = log.info()
    moved = [
        (stamp + frames.behind_ns, _links(shown, frames, odom_from_base, k))
        for k, stamp in enumerate(shown.stamps_ns.tolist())
    ]
    start = info.start_ns
    if moved:
        start, end = min(start, moved[0][0]), max(info.end_ns, moved[-1][0])
        moved = [(start, moved[0][1]), *moved, (end, moved[-1][1])]
    tf = [(time_ns, _TOPIC, _at(time_ns - frames.behind_ns, links)) for time_ns, links in moved]
    first = [t for t in frames.first.values() if _is_kept(t, frames)]
    early = [(start, _TOPIC, _at(start - frames.behind_ns, first))] if first else []
    fixed = [(start, topic, message) for _, topic, message in map_events(shown) if topic != "/tf"]
    return [*tf[:1], *early, *fixed, *tf[1:]]


def _links(
    shown: FoxgloveMap, frames: _Frames, odom_from_base: Array | None, k: int
) -> list[TransformStamped]:
    """What leads from the map to the robot in the frame of this number."""
    pose = shown.map_from_base[k]
    if odom_from_base is None:
        return [TransformStamped(0, MAP, frames.base, pose)]
    correction = pose @ np.linalg.inv(odom_from_base[k])
    links = [TransformStamped(0, MAP, frames.odom, correction)]
    if not frames.reported:
        links.append(TransformStamped(0, frames.odom, frames.base, odom_from_base[k]))
    return links


def _at(stamp_ns: int, links: Sequence[TransformStamped]) -> TransformsMessage:
    return TransformsMessage(tuple(replace(t, stamp_ns=stamp_ns) for t in links), static=False)


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


def _write_tf(raw: RawMessage, frames: _Frames, writer: LogWriter) -> None:
    """The log's own transforms, but for those that a localiser's map would contradict ours by."""
    message = _decoded(raw)
    found = message.transforms if isinstance(message, TransformsMessage) else ()
    if kept := tuple(t for t in found if _is_kept(t, frames)):
        writer.write(raw.topic, replace(message, transforms=kept), raw.log_time_ns)


def _is_kept(transform: TransformStamped, frames: _Frames) -> bool:
    """Not where it would contradict ours."""
    return transform.child.lstrip("/") != frames.odom and transform.parent.lstrip("/") != MAP
