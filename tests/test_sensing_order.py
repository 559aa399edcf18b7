"""Logs whose times are wrong: the order of messages, messages recorded twice, and silence."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from messages_in_memory import MemoryLog, odometry_at, scan_at, transform

from formats.database import MemoryMap
from mapmyworld.api import Silent
from mapmyworld.config import Config, SensingConfig
from mapmyworld.pipeline import build_map
from mapmyworld.sensing import Plan, make_plan, read_frames, survey_log
from mapmyworld.sensing.order import in_stamp_order
from mapmyworld.sensing.synchronise import FrameCounts
from mapmyworld.types import Frame, Message, MessageKind, RawMessage

S = 1_000_000_000
STEP = S // 10
Entries = list[tuple[str, Message, int]]


def drive(steps: int, recorded: Callable[[int], int] = lambda stamp_ns: stamp_ns) -> Entries:
    """A straight drive of 0.1 m a step; `recorded` gives the log time of a stamp."""
    entries: Entries = [("/tf_static", transform("base_link", "laser", (0, 0, 0)), 0)]
    for i in range(steps):
        stamp = (i + 100) * STEP
        entries.append(("/odom", odometry_at(stamp, (0.1 * i, 0, 0)), recorded(stamp)))
        entries.append(("/scan", scan_at(stamp), recorded(stamp) + 1))
    return entries


def read(entries: Entries) -> tuple[Plan, list[Frame], FrameCounts]:
    log, counts = MemoryLog(entries), FrameCounts()
    plan = make_plan(survey_log(log), SensingConfig())
    return plan, list(read_frames(log, plan, SensingConfig(), counts)), counts


def way(frames: list[Frame]) -> float:
    x = [f.odom_from_base[0, 3] for f in frames if f.odom_from_base is not None]
    assert len(x) == len(frames)
    return float(np.abs(np.diff(x)).sum())


def test_where_log_time_steps_back_stamps_decide_the_order() -> None:
    """The recorder's clock was set back by 5 s: two parts of the drive lie over one another."""
    plan, frames, _ = read(drive(160, lambda t: t if t < 18 * S else t - 5 * S))
    assert way(frames) == pytest.approx(15.9)
    assert len(frames) == 160
    (loss,) = plan.losses
    assert "log times are out of order" in loss
    assert not plan.use_log_time
    assert not any("silent" in line for line in plan.warnings)


def test_where_stamps_step_back_but_the_log_indicates_of_motion_its_order_is_kept() -> None:
    """As the Intel log has them: stamps some of which are late, lines in the order of motion."""
    entries: Entries = [("/tf_static", transform("base_link", "laser", (0, 0, 0)), 0)]
    for i in range(100):
        stamp = (i + 100) * STEP - (5 * STEP if i % 10 == 3 else 0)
        entries.append(("/odom", odometry_at(stamp, (0.1 * i, 0, 0)), (i + 100) * STEP))
        entries.append(("/scan", scan_at(stamp), (i + 100) * STEP))
    plan, frames, _ = read(entries)
    assert plan.sort_ns == 0
    assert not plan.losses
    assert "10 times" in "\n".join(plan.warnings)
    assert [f.stamp_ns for f in frames] == [m.stamp_ns for t, m, _ in entries if t == "/scan"]


def test_a_sensor_whose_clock_was_set_back_is_placed_by_log_time() -> None:
    entries = [
        (topic, scan_at(time - 5 * S) if topic == "/scan" and time > 18 * S else message, time)
        for topic, message, time in drive(160)
    ]
    plan, frames, _ = read(entries)
    assert plan.use_log_time
    assert [f.stamp_ns for f in frames] == [time for t, _, time in entries if t == "/scan"]
    (loss,) = plan.losses
    assert "clocks disagree" in loss


@pytest.mark.parametrize("stamp_of", [lambda t: t + 40 * S, lambda t: t - 2 * S, lambda _: 0])
def test_odometry_without_the_laser_s_clock_is_placed_by_log_time(
    stamp_of: Callable[[int], int],
) -> None:
    """A base whose computer has another clock, or whose driver writes no stamps."""
    entries = [
        (topic, odometry_at(stamp_of(time), (time / S, 0, 0)) if topic == "/odom" else m, time)
        for topic, m, time in drive(160)
    ]
    plan, frames, counts = read(entries)
    assert plan.use_log_time
    assert counts.without_odometry == 0
    for frame in frames:
        assert frame.odom_from_base is not None
        assert frame.odom_from_base[0, 3] == pytest.approx(frame.stamp_ns / S, abs=1e-6)


def test_one_clock_set_back_is_a_loss() -> None:
    """Without wheels to indicate which order is right, the log's is kept."""
    scans = [e for e in drive(160) if e[0] != "/odom"]
    back = [
        (topic, scan_at(time - 5 * S) if topic == "/scan" and time > 18 * S else message, time)
        for topic, message, time in scans
    ]
    plan, frames, _ = read(back)
    assert len(frames) == 160
    assert [f.stamp_ns for f in frames] == [m.stamp_ns for t, m, _ in back if t == "/scan"]
    assert "step back 1 times, by up to 4.9" in plan.losses[0]
    assert "doubtful" in plan.losses[0]


@given(st.lists(st.integers(0, 50), max_size=60))
def test_messages_come_by_stamp_where_none_is_later_than_the_wait(late: list[int]) -> None:
    stamps = [10 * i - delay for i, delay in enumerate(late)]
    raw = [
        RawMessage("/t", MessageKind.ODOMETRY, 7, stamp, lambda: odometry_at(0, (0, 0, 0)))
        for stamp in stamps
    ]
    found = [(m.stamp_ns, m.log_time_ns) for m in in_stamp_order(raw, 60)]
    assert found == [(stamp, stamp) for stamp in sorted(stamps)]


def test_a_message_recorded_twice_is_one_frame() -> None:
    once = drive(20)
    _, frames, counts = read([entry for entry in once for _ in range(2)])
    assert [f.stamp_ns for f in frames] == [m.stamp_ns for t, m, _ in once if t == "/scan"]
    assert counts.repeated == 20


def test_a_sensor_without_stamps_is_named() -> None:
    entries = [
        (topic, scan_at(0) if topic == "/scan" else message, time)
        for topic, message, time in drive(20)
    ]
    plan, frames, _ = read(entries)
    assert plan.use_log_time
    assert len(frames) == 20
    (loss,) = plan.losses
    assert loss.startswith("/scan: header stamps are missing (0)")


@pytest.mark.parametrize("topic", ["/scan", "/odom"])
@pytest.mark.parametrize(
    ("silent", "word"),
    [
        ((0, 18), "begins 8.0 s after the other sensors"),
        ((18, 99), "stops 8.0 s before the log ends, 7.9 s after its start"),
        ((13, 20), "silent for 7.1 s, from 2.9 s after the start"),
    ],
)
def test_a_sensor_that_is_silent_for_long_is_a_loss(
    topic: str, silent: tuple[int, int], word: str
) -> None:
    entries = [e for e in drive(160) if e[0] != topic or not silent[0] * S <= e[2] < silent[1] * S]
    (loss,) = read(entries)[0].losses
    assert loss.startswith(f"{topic}: {word}")
    assert "no data from it" in loss


@pytest.mark.parametrize("silent", [(0, 13), (23, 99), (13, 16)])
def test_a_short_silence_is_a_note(silent: tuple[int, int]) -> None:
    kept = [e for e in drive(160) if e[0] != "/scan" or not silent[0] * S <= e[2] < silent[1] * S]
    plan = read(kept)[0]
    assert not plan.losses
    assert "/scan: " in "\n".join(plan.warnings)


@pytest.mark.parametrize("log_time", [0, 2**63 - 2])
def test_log_times_that_do_not_pass_cost_no_sensor(log_time: int) -> None:
    """All at zero, or at the end of time, as where the recorder had no clock: stamps are there."""
    plan, frames, _ = read(drive(20, lambda _: log_time))
    assert plan.scan is not None
    assert not plan.use_log_time
    assert [frame.stamp_ns for frame in frames] == [(i + 100) * STEP for i in range(20)]


def test_a_log_that_runs_backwards_is_not_called_one_without_stamps() -> None:
    plan, frames, _ = read(drive(20, lambda stamp: 1000 * S - stamp))
    assert len(frames) == 20
    assert not plan.use_log_time
    assert any("stamps step back 19 times, by up to 1.900 s" in loss for loss in plan.losses)
    assert not any("no header stamps" in loss for loss in plan.losses)


def test_a_build_indicates_the_length_of_the_drive_by_its_stamps() -> None:
    log = MemoryLog(drive(20, lambda _: 0))
    result = build_map(log, MemoryMap(), Config(), Silent())
    assert result.duration_s == pytest.approx(1.9)
    assert result.frames == 20
