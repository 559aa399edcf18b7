"""Time offsets between sensors, and whether one is upside down, by how they saw the robot turn."""

from __future__ import annotations

import numpy as np

from mapmyworld.diagnosis.finding import SENSE_OF_TURNING, Finding
from mapmyworld.geometry import Array

_REACH = 0.4  # s, offsets that are tried to both sides
_STEP = 0.01  # s
_LEAST_TURN = 0.006  # rad, mean turn between neighbouring frames below which nothing can be said
_LEAST_PAIRS = 30
_BETTER = 1.5  # by which the error must fall at the offset, against none
_WORTH_SAYING = 0.02  # s
_SETTINGS = {"odometry": "odometry_offset", "gyroscope": "imu_offset"}
ODOMETRY_TO_LASER = "time offset of odometry to laser"
"""The finding of that name."""


def time_offset(
    names: tuple[str, str], starts: Array, ends: Array, turns: Array, clock: tuple[Array, Array]
) -> Finding | None:
    """By how much the second sensor's stamps lie after the first's; None where it hardly turns.

    `turns` (N,) in rad of the first between `starts` and `ends` (N,) in s; `clock`: times in s and
    unwrapped headings in rad of the second, (M,) both. The offset is that at which both agree best;
    the error is capped, so that slips and mismatches weigh little. Where they agree once one is
    turned round, that is said instead.
    """
    known = (starts > clock[0][0] + _REACH) & (ends < clock[0][-1] - _REACH)
    starts, ends, turns = starts[known], ends[known], turns[known]
    if len(turns) < _LEAST_PAIRS or np.mean(np.abs(turns)) < _LEAST_TURN:
        return None
    offsets, errors = _tried(starts, ends, turns, clock)
    mirrored = min(_error(starts + d, ends + d, -turns, clock) for d in offsets)
    if errors.min() > _BETTER * mirrored:
        return _backwards(names, len(turns))
    best = int(np.argmin(errors))
    offset = _lowest(offsets, errors, best)
    # Half-way between two headings their noise is averaged, which agrees better on both sides.
    others = min(errors[len(offsets) // 2], errors[len(offsets) - 1 - best])
    certain = others > _BETTER * errors[best]
    # Most seconds between the headings of the second sensor: what averaging alone can feign.
    apart = np.percentile(np.diff(np.unique(clock[0])), 90)
    name = f"time offset of {names[1]} to {names[0]}"
    if not certain and abs(offset) < apart:
        none = f"no time offset between {names[1]} and {names[0]} detected ({len(turns)} pairs)"
        return Finding(name, 0.0, "s", True, none)
    good = not certain or abs(offset) < _WORTH_SAYING
    order = "later" if offset > 0 else "earlier"
    doubt = ", uncertain" if not certain and abs(offset) >= _WORTH_SAYING else ""
    text = (
        f"{names[1]} is stamped {abs(offset):.3f} s {order} than the {names[0]} "
        f"({len(turns)} pairs of rotations{doubt})"
    )
    suggestion = (
        "correct the stamps where they are made (driver latency, clock synchronisation), or "
        f"set sensing.{_SETTINGS[names[1]]} = {-offset:.3f}"
    )
    return Finding(name, offset, "s", good, text, suggestion)


def nearest_offset(
    starts: Array, ends: Array, turns: Array, clock: tuple[Array, Array]
) -> tuple[float, float]:
    """The offset (s) at which both agree best, however little better, and the error without, rad.

    `starts`, `ends` and `turns` (N,), and `clock`, (M,) both, as of `time_offset`.
    """
    offsets, errors = _tried(starts, ends, turns, clock)
    return _lowest(offsets, errors, int(np.argmin(errors))), float(errors[len(offsets) // 2])


def _tried(
    starts: Array, ends: Array, turns: Array, clock: tuple[Array, Array]
) -> tuple[Array, Array]:
    offsets = np.arange(-_REACH, _REACH + _STEP / 2, _STEP)
    return offsets, np.array([_error(starts + d, ends + d, turns, clock) for d in offsets])


def _backwards(names: tuple[str, str], pairs: int) -> Finding:
    mount = "camera_mount" if names[0] == "camera" else "scan_mount"
    text = (
        f"{names[1]} and {names[0]} disagree on the sense of rotation ({pairs} pairs): "
        "the map may be mirrored"
    )
    suggestion = (
        f"if the {names[0]} hangs upside down, state it in tf or by sensing.{mount} (roll "
        f"3.14159); else correct the sign of the rotation in {names[1]}"
    )
    return Finding(SENSE_OF_TURNING, -1.0, "", False, text, suggestion)


def _error(starts: Array, ends: Array, turns: Array, clock: tuple[Array, Array]) -> float:
    seen = np.interp(ends, *clock) - np.interp(starts, *clock)
    return float(np.minimum(np.abs(seen - turns), 0.05).mean())


def _lowest(offsets: Array, errors: Array, best: int) -> float:
    """The offset at the vertex of the parabola through the smallest error and its neighbours."""
    offset = float(offsets[best])
    if not 0 < best < len(errors) - 1:
        return offset
    left, middle, right = errors[best - 1 : best + 2]
    bend = left - 2.0 * middle + right
    return offset + _STEP * float(0.5 * (left - right) / bend) if 0.0 < bend < np.inf else offset
