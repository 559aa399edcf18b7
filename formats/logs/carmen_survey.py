"""One look over a whole CARMEN log: what it counts, how the lasers sit, how far they see."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from formats.bounds import FARTHEST
from formats.logs.carmen_records import (
    LASER_FRAMES,
    LASER_TOPICS,
    RAW_LASERS,
    REAR_LASERS,
    LaserRecord,
)
from mapmyworld.geometry.planar import between_planar, wrap_angle

_AT_ONCE = 256  # sweeps
_BINS = 1024  # of one metre each
_REPEATED = 10  # times a value must occur before it can mean "no return"
_GAP = 0.8  # a no-return value stands at least this far, as a share, above every real return
_CODES = 81.825, 81.925  # m: 8183 to 8191 cm are a SICK's words for "no return", not distances
_CONSTANT_M = 0.02  # a mounting whose middle half of samples spreads more is a corrected pose
_MOUNTING_SAMPLES = 2000
_RANGE_PARAMETERS = (b"robot_front_laser_max", b"robot_frontlaser_max")

Reading = LaserRecord | list[float] | bytes
"""A laser's line as a sweep, its numbers where it has five; a parameter's as it is."""
Line = tuple[bytes, Reading, int, int]
"""Kind, what was read, stamp and log time in ns."""


@dataclass
class Survey:
    """What the lines of a log indicate together."""

    parameters: dict[bytes, bytes] = field(default_factory=dict)
    range_max: dict[bytes, float] = field(default_factory=dict)
    base_from_laser: dict[str, NDArray[np.float64]] = field(default_factory=dict)
    """Frame -> (3,) x, y, yaw."""
    doubts: dict[str, str] = field(default_factory=dict)
    """Topic -> what is doubtful of it, though every line is sound."""

    @cached_property
    def unused(self) -> set[bytes]:
        """Sweeps without pose, where the same laser has some with; CARMEN often logs both."""
        told = {LASER_TOPICS[kind] for kind in self.range_max.keys() - RAW_LASERS}
        return {kind for kind in RAW_LASERS & self.range_max.keys() if LASER_TOPICS[kind] in told}


def longest_return(histogram: NDArray[np.int64], single: NDArray[np.bool_]) -> float:
    """Metres below which all real returns lie, given counts (N,) of readings by whole metres.

    `single` (N,) indicates where all of a metre's readings are one and the same value. Such a
    value, repeated at the top, far above all others, is what the driver writes for "no return";
    there may be two of them (50.0 and 81.83, say).
    """
    occupied = np.flatnonzero(histogram)
    while len(occupied) > 1:
        top, below = occupied[-1], occupied[-2]
        if not single[top] or histogram[top] < _REPEATED or below + 1 > _GAP * top:
            break
        occupied = occupied[:-1]
    return float(occupied[-1] + 1) if len(occupied) else 0.0


def add_laser(survey: Survey, kind: bytes, records: Sequence[LaserRecord]) -> None:
    """Concludes on one laser: its largest range and where it sits on the robot."""
    histogram = np.zeros(_BINS, np.int64)
    lowest, highest = np.full(_BINS, np.inf, np.float32), np.zeros(_BINS, np.float32)
    for first in range(0, len(records), _AT_ONCE):
        ranges = np.concatenate([record.ranges for record in records[first : first + _AT_ONCE]])
        ranges = ranges[np.isfinite(ranges)]
        bins = np.clip(ranges, 0, _BINS - 1).astype(np.int64)
        histogram += np.bincount(bins, minlength=_BINS)
        np.minimum.at(lowest, bins, ranges)
        np.maximum.at(highest, bins, ranges)
    seen = longest_return(histogram, lowest == highest)
    range_max = _range_max(survey.parameters, histogram, seen)
    if _CODES[0] <= highest.max() < _CODES[1]:  # real returns may come as near as that
        range_max = min(range_max, _CODES[0])
    survey.range_max[kind] = range_max
    frame = LASER_FRAMES[kind]
    if frame in survey.base_from_laser:
        return
    poses = [(r.odom_from_base, r.odom_from_laser) for r in records if r.odom_from_base]
    samples = np.reshape(poses[:_MOUNTING_SAMPLES], (-1, 2, 3))
    samples = samples[np.abs(samples).max(axis=(1, 2)) < FARTHEST]
    if len(samples):
        mountings = between_planar(samples[:, 0], samples[:, 1])
        survey.base_from_laser[frame] = _mounting(survey, kind, mountings)
        return
    survey.base_from_laser[frame] = _reported_mounting(survey, kind)
    if _offset_name(kind) not in survey.parameters:
        survey.doubts[LASER_TOPICS[kind]] = (
            f"{kind.decode()} lines give no laser mount, nor does PARAM "
            f"{_offset_name(kind).decode()}: the robot's centre is assumed"
        )


def _range_max(parameters: dict[bytes, bytes], histogram: NDArray[np.int64], seen: float) -> float:
    """The recorded parameter, where the log's no-return values lie above it, else what is seen."""
    no_returns = np.flatnonzero(histogram[int(seen) :]) + int(seen)
    for name in _RANGE_PARAMETERS:
        value = _number(parameters.get(name, b""))
        if value >= seen and (len(no_returns) == 0 or value <= no_returns[0]):
            return value
    return seen


def _mounting(survey: Survey, kind: bytes, samples: NDArray[np.float64]) -> NDArray[np.float64]:
    """base_from_laser (3,): laser pose relative to robot pose, where that is constant."""
    # Angles about their mean direction: those of a laser that looks back lie on both sides of pi.
    mean = np.angle(np.exp(1j * samples[:, 2]).mean())
    samples[:, 2] = wrap_angle(samples[:, 2] - mean)
    low, middle, high = np.percentile(samples, [25, 50, 75], axis=0)
    if np.all(high - low < _CONSTANT_M):
        middle[2] = wrap_angle(middle[2] + mean)
        # Five decimals: the log has six, and a difference loses one. Adding zero avoids -0.
        return np.asarray(np.round(middle, 5) + 0.0, np.float64)
    survey.doubts[LASER_TOPICS[kind]] = (
        f"{kind.decode()}: laser pose minus robot pose varies, so it is no mount "
        "(a corrected log?): PARAM's mount is used, else the robot's centre"
    )
    return _reported_mounting(survey, kind)


def _reported_mounting(survey: Survey, kind: bytes) -> NDArray[np.float64]:
    """base_from_laser (3,) by PARAM, else the robot's centre; a rear laser looks back."""
    forward = _number(survey.parameters.get(_offset_name(kind), b""))
    return np.array([forward, 0.0, np.pi if kind in REAR_LASERS else 0.0])


def _offset_name(kind: bytes) -> bytes:
    return b"robot_rearlaser_offset" if kind in REAR_LASERS else b"robot_frontlaser_offset"


def _number(text: bytes) -> float:
    try:
        value = float(text)
    except ValueError:
        return 0.0
    return value if abs(value) < FARTHEST else 0.0


def survey_lines(lines: Iterable[Line]) -> Survey:
    """Survey of lines as they were read; PARAM lines included."""
    survey, lasers = Survey(), defaultdict[bytes, list[LaserRecord]](list)
    for kind, read, _, _ in lines:
        if isinstance(read, LaserRecord):
            lasers[kind].append(read)
        elif isinstance(read, bytes):
            name, value = [*read.split(None, 3), b"", b""][1:3]
            survey.parameters[name] = value
    for kind, records in sorted(lasers.items(), key=lambda item: (item[0] in RAW_LASERS, item[0])):
        add_laser(survey, kind, records)
    return survey
