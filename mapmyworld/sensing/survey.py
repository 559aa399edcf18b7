"""One pass over a log before anything is decided: all of tf and odometry, a sample of the rest."""

from __future__ import annotations

from array import array
from collections import defaultdict
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import TypeVar

from mapmyworld.errors import LogError
from mapmyworld.sensing.motion import MotionRecorder, RecordedMotion
from mapmyworld.sensing.slopes import Forces
from mapmyworld.sensing.sweeps import valid_ranges
from mapmyworld.sensing.transforms import TransformTree
from mapmyworld.types import (
    ImuMessage,
    LaserScanMessage,
    LogInfo,
    LogSource,
    Message,
    MessageKind,
    OdometryMessage,
    RawMessage,
    TransformsMessage,
)

_SAMPLES = 5  # messages of a stream that are decoded to see what it carries
_OFFSETS = 256  # messages whose clocks are compared, spread by doubling the stride

Wanted = TypeVar("Wanted")


@dataclass(slots=True)
class Stream:
    """What is known of a topic: rate, clock and its first messages."""

    topic: str
    kind: MessageKind
    count: int = 0
    first_log_ns: int = 0
    last_log_ns: int = 0
    first_stamp_ns: int | None = None
    last_stamp_ns: int | None = None
    latest_stamp_ns: int = 0
    backward_steps: int = 0
    largest_lag_ns: int = 0
    """By how much a stamp lay before one that came earlier, at most."""
    largest_gap_ns: int = 0
    """Of silence between two messages, by header stamps as by log times."""
    gap_start_ns: int = 0
    """Log time at which it began."""
    undecodable: int = 0
    samples: list[Message] = field(default_factory=list)
    has_returns: bool = False
    """Whether a scan with a usable range is among them; until one is, all scans are looked at."""
    offsets_ns: array[int] = field(default_factory=lambda: array("q"))
    stamps_ns: array[int] = field(default_factory=lambda: array("q"))
    """Every header stamp, of laser scans only."""
    _stride: int = 1

    def add(self, raw: RawMessage) -> None:
        """One more message, in the order of the log."""
        if self.count == 0:
            self.first_log_ns = self.last_log_ns = raw.log_time_ns
        gap_ns = raw.log_time_ns - self.last_log_ns
        if gap_ns > self.largest_gap_ns:
            if raw.stamp_ns and self.last_stamp_ns:
                gap_ns = min(gap_ns, raw.stamp_ns - self.last_stamp_ns)
            if gap_ns > self.largest_gap_ns:
                self.largest_gap_ns, self.gap_start_ns = gap_ns, self.last_log_ns
        if raw.stamp_ns is not None:
            self._add_stamp(raw.stamp_ns, raw.log_time_ns)
            if self.kind is MessageKind.LASER_SCAN:
                self.stamps_ns.append(raw.stamp_ns)
        self.last_log_ns = raw.log_time_ns
        self.count += 1

    def _add_stamp(self, stamp_ns: int, log_time_ns: int) -> None:
        if self.last_stamp_ns is None:
            self.first_stamp_ns = self.latest_stamp_ns = stamp_ns
        else:
            if stamp_ns < self.last_stamp_ns:
                self.backward_steps += 1
            if stamp_ns >= self.latest_stamp_ns:
                self.latest_stamp_ns = stamp_ns
            else:
                self.largest_lag_ns = max(self.largest_lag_ns, self.latest_stamp_ns - stamp_ns)
        self.last_stamp_ns = stamp_ns
        if self.count % self._stride == 0:
            self.offsets_ns.append(log_time_ns - stamp_ns)
            if len(self.offsets_ns) >= _OFFSETS:
                self.offsets_ns = self.offsets_ns[::2]
                self._stride *= 2

    @property
    def frequency(self) -> float:
        """Mean rate in Hz by log time, or by stamp where all log times are one; 0 where unknown."""
        span = self.last_log_ns - self.first_log_ns
        if span == 0 and self.first_stamp_ns is not None:
            span = self.latest_stamp_ns - self.first_stamp_ns
        return (self.count - 1) / (span * 1e-9) if self.count > 1 and span > 0 else 0.0

    def first(self, kind: type[Wanted]) -> Wanted | None:
        """The first of the decoded messages that is of a type; None without any."""
        return next((message for message in self.samples if isinstance(message, kind)), None)


@dataclass(frozen=True, slots=True, eq=False)
class Survey:
    """Everything that deciding needs, in memory that grows only by tf and odometry."""

    info: LogInfo
    streams: dict[str, Stream]
    tree: TransformTree
    odometry: dict[str, RecordedMotion]
    """Topic -> its poses, in the order of the log."""
    odometry_frames: dict[str, tuple[str, str]]
    """Topic -> its frame and child frame, as recorded."""
    slopes: dict[str, float]
    """Inertial topic -> radians by which the robot leaned, for some seconds, at most."""

    def of_kind(self, kind: MessageKind) -> list[Stream]:
        """The streams of a kind that hold messages, by topic."""
        found = (s for s in self.streams.values() if s.kind is kind and s.count)
        return sorted(found, key=lambda stream: stream.topic)

    def fullest(self, kind: MessageKind) -> Stream | None:
        """The stream of a kind with the most messages; None without any."""
        return max(self.of_kind(kind), key=lambda s: (s.count, s.topic), default=None)


class _Surveyor:
    def __init__(self) -> None:
        self.streams: dict[str, Stream] = {}
        self.tree = TransformTree()
        self.recorders: defaultdict[str, MotionRecorder] = defaultdict(MotionRecorder)
        self.frames: dict[str, tuple[str, str]] = {}
        self.forces: defaultdict[str, Forces] = defaultdict(Forces)

    def add(self, raw: RawMessage) -> None:
        stream = self.streams.get(raw.topic)
        if stream is None:
            stream = self.streams[raw.topic] = Stream(raw.topic, raw.kind)
        stream.add(raw)
        if self._wants(raw, stream):
            self._decode(raw, stream)

    def _wants(self, raw: RawMessage, stream: Stream) -> bool:
        """Whether a message is decoded: all that move frames, of scans until one has a range."""
        whole = raw.kind is MessageKind.TRANSFORMS or raw.kind is MessageKind.ODOMETRY
        is_blind = raw.kind is MessageKind.LASER_SCAN and not stream.has_returns
        if whole or is_blind or len(stream.samples) < _SAMPLES:
            return True
        return raw.kind is MessageKind.IMU and self.forces[raw.topic].wants(raw.log_time_ns)

    def _decode(self, raw: RawMessage, stream: Stream) -> None:
        try:
            message = raw.decode()
        except LogError:
            stream.undecodable += 1
            return
        found = isinstance(message, LaserScanMessage) and bool(valid_ranges(message).any())
        if len(stream.samples) < _SAMPLES or (found and not stream.has_returns):
            stream.samples.append(message)
        stream.has_returns |= found
        if isinstance(message, TransformsMessage):
            self.tree.add(message)
        elif isinstance(message, ImuMessage):
            self.forces[raw.topic].add(message, raw.log_time_ns)
        elif isinstance(message, OdometryMessage):
            motion = self.recorders[raw.topic]
            if motion.add(message.stamp_ns, message.pose, raw.log_time_ns):
                self.frames[raw.topic] = (message.frame_id, message.child_frame_id)
            else:
                stream.undecodable += 1


def survey_log(log: LogSource, watch: Callable[[int], None] | None = None) -> Survey:
    """Reads the log once; `watch` is given the log time reached, for progress."""
    topics = log.info().topics
    ignored = {t.topic for t in topics if t.kind is MessageKind.OTHER}
    surveyor = _Surveyor()
    for raw in log.messages([t.topic for t in topics if t.topic not in ignored]):
        surveyor.add(raw)
        if watch is not None:
            watch(raw.log_time_ns)
    surveyor.tree.finish()
    return Survey(
        info=log.info(),
        streams=surveyor.streams,
        tree=surveyor.tree,
        odometry={topic: surveyor.recorders[topic].finish() for topic in surveyor.frames},
        odometry_frames=surveyor.frames,
        slopes={topic: forces.slope() for topic, forces in surveyor.forces.items()},
    )
