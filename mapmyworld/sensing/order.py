"""In which order a log reports the motion: that of its log times, or of its header stamps."""

from __future__ import annotations

import heapq
from collections.abc import Iterable, Iterator
from dataclasses import replace

from mapmyworld.sensing.plan import Draft, OdometrySource
from mapmyworld.sensing.survey import Stream
from mapmyworld.types import RawMessage

_SHORTER = 0.8  # of the way by log time that the way by header stamps must stay below
_INTERLEAVED = 0.1  # share of stamps that step back from which two times of a drive are mixed
_APART_NS = 1_000_000_000  # by which sensors' header stamps may differ where messages are sorted
_FARTHEST_NS = 30_000_000_000  # messages that far apart are not held in memory to be sorted


def choose_order(
    draft: Draft, used: list[Stream], odometry: OdometrySource | None
) -> tuple[int, OdometrySource | None]:
    """How long messages wait to be put in the order of their stamps, in ns, and the odometry so.

    0 where the order of the log is kept: real logs step back in their stamps and are right.
    """
    back = [stream for stream in used if stream.backward_steps]
    if not back:
        return 0, odometry
    lag_ns = max(stream.largest_lag_ns for stream in back)
    steps = sum(stream.backward_steps for stream in back)
    reported = (
        f"{steps} messages have header stamps up to {lag_ns * 1e-9:.3f} s before earlier ones"
    )
    names = ", ".join(stream.topic for stream in back)
    if _stamps_are_right(back, odometry) and lag_ns < _FARTHEST_NS:
        draft.decide("order", "header stamps", f"log times would make the robot jump; {reported}")
        draft.losses.append(
            f"{names}: log times are out of order ({reported}): messages are put in the order of "
            "header stamps"
        )
        if odometry is not None:
            odometry = OdometrySource(odometry.name, odometry.motion.in_stamp_order())
        return lag_ns + _APART_NS, odometry
    return 0, odometry


def check_stamps(draft: Draft, used: list[Stream]) -> None:
    """Words about stamps that step back and are used all the same, in the order of the log."""
    for stream in used:
        if not stream.backward_steps:
            continue
        reported = (
            f"{stream.topic}: header stamps step back {stream.backward_steps} times, by up to "
            f"{stream.largest_lag_ns * 1e-9:.3f} s; the order of the log is kept"
        )
        if stream.largest_lag_ns > _APART_NS:
            draft.losses.append(
                f"{reported}, so the times of its poses are doubtful: was a clock set while "
                "recording?"
            )
        else:
            draft.warnings.append(reported)


def _stamps_are_right(back: list[Stream], odometry: OdometrySource | None) -> bool:
    """Whether the wheels went a much shorter way by header stamps than by log time.

    Without wheels: whether stamps step back all the time, as where two times of a drive are mixed.
    """
    if odometry is None or odometry.motion.is_sorted:
        return any(s.backward_steps > _INTERLEAVED * s.count for s in back)
    distance = odometry.motion.distance()
    return odometry.motion.in_stamp_order().distance() < _SHORTER * distance


def in_stamp_order(messages: Iterable[RawMessage], wait_ns: int) -> Iterator[RawMessage]:
    """Messages by header stamp, which becomes their log time; each waits `wait_ns` for others."""
    waiting: list[tuple[int, int, RawMessage]] = []
    latest_ns = 0
    for number, raw in enumerate(messages):
        stamp_ns = latest_ns if raw.stamp_ns is None else raw.stamp_ns
        latest_ns = max(latest_ns, stamp_ns)
        heapq.heappush(waiting, (stamp_ns, number, replace(raw, log_time_ns=stamp_ns)))
        while waiting[0][0] < latest_ns - wait_ns:
            yield heapq.heappop(waiting)[2]
    while waiting:
        yield heapq.heappop(waiting)[2]
