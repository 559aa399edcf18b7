"""Sensors whose stamps are off: shifted by settings, and by what tracking measured beyond doubt."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from conftest import ROOT

import mapmyworld
from mapmyworld.api import Silent
from mapmyworld.diagnosis.rotation import time_offset
from mapmyworld.memory_log import MemoryLog
from mapmyworld.sensing import make_plan, read_frames, survey_log
from mapmyworld.types import LaserScanMessage, Message, OdometryMessage, TransformsMessage

Entry = tuple[str, Message, int]
LATE_S = 0.12
APARTMENT = ROOT / "sample_logs" / "apartment.mcap"


@cache
def apartment() -> tuple[Entry, ...]:
    """Laser, wheels and fixed transforms of the sample drive."""
    kept = LaserScanMessage | OdometryMessage | TransformsMessage
    topics = ("/graph_slam_bot/laser/scan", "/odom", "/tf_static")
    messages = mapmyworld.open_log([APARTMENT]).messages(topics)
    decoded = ((raw.topic, raw.decode(), raw.log_time_ns) for raw in messages)
    return tuple(entry for entry in decoded if isinstance(entry[1], kept))


def late(kind: type, seconds: float) -> MemoryLog:
    """The drive with one sensor's stamps shifted."""

    def shifted(message: Message) -> Message:
        if not isinstance(message, kind):
            return message
        stamp_ns = message.stamp_ns + round(seconds * 1e9)
        return replace(message, stamp_ns=stamp_ns)  # type: ignore[call-arg]

    return MemoryLog([(topic, shifted(m), time) for topic, m, time in apartment()])


def frames(log: MemoryLog, **settings: float) -> list[tuple[int, bytes]]:
    config = mapmyworld.configured(**{f"sensing__{k}": v for k, v in settings.items()})
    plan = make_plan(survey_log(log), config.sensing)
    found = read_frames(log, plan, config.sensing)
    return [(f.stamp_ns, f.odom_from_base.tobytes()) for f in found if f.odom_from_base is not None]


@pytest.mark.parametrize(
    ("kind", "setting"), [(OdometryMessage, "odometry_offset"), (LaserScanMessage, "scan_offset")]
)
def test_a_setting_takes_a_sensors_offset_back(kind: type, setting: str) -> None:
    sound = frames(late(kind, 0.0))
    assert frames(late(kind, LATE_S)) != sound
    assert frames(late(kind, LATE_S), **{setting: -LATE_S})[5:-5] == sound[5:-5]


def test_images_are_shifted_with_their_stamp() -> None:
    log = mapmyworld.open_log([APARTMENT])
    shown = []
    for offset in (0.0, 0.2):
        config = mapmyworld.configured(sensing__camera_offset=offset)
        plan = make_plan(survey_log(log), config.sensing)
        images = [f.images[0] for f in read_frames(log, plan, config.sensing) if f.images]
        shown.append(np.array([i.colour.stamp_ns for i in images if i.colour is not None]))
    assert np.isin(shown[0] + 200_000_000, shown[1]).mean() > 0.9


def test_an_offset_beyond_doubt_is_taken_back_by_itself() -> None:
    progress, log = Silent(), late(OdometryMessage, LATE_S)
    found = mapmyworld.build(log, progress=progress)
    reported = [note for note in progress.notes if "odometry is stamped" in note]
    assert "its stamps are shifted by -0.1" in reported[-1]
    assert found.map.get("track")["notes"].count(reported[-1]) == 1
    findings = {f["name"]: f for f in found.map.get("diagnosis")}
    assert findings["time offset of odometry to laser"]["good"]
    assert found.map.get("track")["odometry_lag_s"] == pytest.approx(LATE_S, abs=0.01)
    assert "track" in mapmyworld.build(log, into=found.map).result.reused_stages
    by_hand = mapmyworld.configured(sensing__odometry_offset=-LATE_S)
    assert mapmyworld.build(log, config=by_hand).map.get("track")["odometry_lag_s"] == 0.0


def test_a_sound_log_is_tracked_once() -> None:
    found = mapmyworld.build(late(OdometryMessage, 0.0))
    assert found.map.get("track")["odometry_lag_s"] == 0.0


@pytest.mark.parametrize(
    ("name", "setting"), [("odometry", "odometry_offset"), ("gyroscope", "imu_offset")]
)
def test_the_suggestion_names_the_setting_and_its_sign(name: str, setting: str) -> None:
    times = np.arange(0.0, 60.0, 0.1)
    heading = np.sin(times)
    clock = (times + 0.1, heading)  # stamped 0.1 s late
    found = time_offset(("laser", name), times[:-1], times[1:], np.diff(heading), clock)
    assert found is not None
    assert f"set sensing.{setting} = -0.1" in found.suggestion
