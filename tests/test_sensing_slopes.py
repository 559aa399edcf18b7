"""Sensors that a flat map ignores or flattens are reported: slopes, 3D lidars, unmounted IMUs."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from room_drive import START_NS, STEP_NS, drive

from mapmyworld.config import SensingConfig
from mapmyworld.memory_log import MemoryLog
from mapmyworld.sensing import make_plan, survey_log
from mapmyworld.types import ImuMessage

G = 9.81


def felt(
    slope_deg: float, seconds: float, *, braking: float = 0.0, frame: str = "base_link",
    damaged: int = -1,
) -> MemoryLog:  # fmt: skip
    """The room's drive with an inertial sensor that feels a slope from its third second on.

    One sample's force may be damaged so that its square is beyond what a number holds.
    """
    entries, rng = list(drive(150).entries), np.random.default_rng(0)
    for k in range(int(150 * STEP_NS * 1e-9 * 50)):
        time = k / 50.0
        lean = np.radians(slope_deg) if 3.0 <= time < 3.0 + seconds else 0.0
        push = braking if int(time) % 3 == 0 and time % 1.0 < 0.5 else 0.0
        force = G * np.array([np.sin(lean), 0.0, np.cos(lean)]) + [push, 0.0, 0.0]
        force += rng.normal(0.0, 0.3, 3)
        force = np.array([1e200, -1e300, G]) if k == damaged else force
        stamp = START_NS + round(time * 1e9)
        entries.append(("/imu", ImuMessage(stamp, frame, None, np.zeros(3), force), stamp))
    return MemoryLog(entries)


def losses(log: MemoryLog) -> str:
    return " | ".join(make_plan(survey_log(log), SensingConfig()).losses)


def test_a_slope_under_a_flat_map_is_reported_with_its_angle() -> None:
    reported = losses(felt(8.0, 6.0))
    assert (
        "/imu measures slopes of up to 8." in reported
        or "/imu measures slopes of up to 7." in reported
    )
    assert "the map is flat" in reported


@pytest.mark.parametrize(
    "log", [felt(0.0, 0.0), felt(0.0, 0.0, braking=1.5), felt(2.0, 6.0), felt(8.0, 0.3)]
)
def test_level_ground_braking_and_a_threshold_are_no_slope(log: MemoryLog) -> None:
    assert "slopes" not in losses(log)


@pytest.mark.filterwarnings("error")
def test_a_damaged_force_is_no_slope_and_no_warning() -> None:
    assert "slopes" not in losses(felt(0.0, 0.0, damaged=204))  # one of those that are looked at


def test_an_inertial_sensor_that_sits_nowhere_is_a_loss() -> None:
    assert "/imu is left out: tf does not say how elsewhere is mounted" in losses(
        felt(0.0, 0.0, frame="elsewhere")
    )
    assert "left out" not in losses(felt(0.0, 0.0))


def test_few_samples_are_decoded_for_it() -> None:
    """At most ten a second: a drive may last for hours."""
    log, decoded = felt(0.0, 0.0), [0]
    messages = log.messages

    def counted(topics=None):
        for raw in messages(topics):

            def decode(raw=raw):
                decoded[0] += raw.topic == "/imu"
                return raw.decode()

            yield replace(raw, decode=decode)

    log.messages = counted  # type: ignore[method-assign]
    survey_log(log)
    assert decoded[0] <= 150 * STEP_NS * 1e-9 * 10 + 6
