"""Depth in a wrong unit is found by the odometry's distances where a log has no laser."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from messages_in_memory import MemoryLog

from formats.database import MemoryMap
from mapmyworld.api import Silent
from mapmyworld.config import Config
from mapmyworld.diagnosis import Finding, diagnose
from mapmyworld.diagnosis.depth_motion import pairs_along_the_path
from mapmyworld.diagnosis.depth_on_laser import unit_suggestion
from mapmyworld.geometry import Array
from mapmyworld.geometry.planar import planar_to_matrix
from mapmyworld.pipeline import build_map
from mapmyworld.sensing import make_plan, survey_log
from mapmyworld.simulation import SimulationSettings, simulate
from mapmyworld.simulation.worlds import find_world
from mapmyworld.types import ImageMessage, LaserScanMessage, Message

Entry = tuple[str, Message, int]


@cache
def drive() -> tuple[Entry, ...]:
    settings = SimulationSettings()
    camera = replace(settings.camera, width=320, height=240, rate=5.0, compressed=False)
    settings = replace(settings, camera=camera, laser=replace(settings.laser, beams=31))
    made = simulate(find_world("apartment"), seed=3, route="1.0,0.1 turn:40", settings=settings)
    return tuple(entry for entry in made.messages() if not isinstance(entry[1], LaserScanMessage))


def log_of(factor: float) -> MemoryLog:
    def scaled(message: Message) -> Message:
        if isinstance(message, ImageMessage) and message.is_depth:
            cells = message.pixels() * np.float32(factor)
            return replace(message, pixels=lambda: cells)
        return message

    return MemoryLog([(topic, scaled(message), time) for topic, message, time in drive()])


def findings(factor: float) -> dict[str, Finding]:
    log = log_of(factor)
    plan = make_plan(survey_log(log), Config().sensing)
    assert plan.scan is None
    return {finding.name: finding for finding in diagnose(log, plan, Config())}


@pytest.mark.parametrize(
    ("factor", "word"), [(5.0, "1/5000 m"), (1000.0, "millimetres"), (0.7, "by a factor of 1.4")]
)
@pytest.mark.slow
def test_depth_in_another_unit_is_measured_without_a_laser(factor: float, word: str) -> None:
    found = findings(factor)["depth scale"]
    assert not found.good
    assert found.value == pytest.approx(factor, rel=0.05)
    assert word in found.suggestion


@pytest.mark.slow
def test_sound_depth_is_found_sound_without_a_laser() -> None:
    found = findings(1.0)
    assert found["depth scale"].value == pytest.approx(1.0, abs=0.05)
    assert [finding.text for finding in found.values() if not finding.good] == []


@pytest.mark.slow
def test_a_build_indicates_depth_in_another_unit_as_well() -> None:
    store = MemoryMap()
    build_map(log_of(5.0), store, Config(), Silent())
    reported = {found["name"]: found for found in store.get("diagnosis")}["depth scale"]
    assert reported["value"] == pytest.approx(5.0, rel=0.05)
    assert any("1/5000 m" in note for note in store.get("track")["notes"])


def test_pairs_lie_a_little_apart_and_hardly_turned() -> None:
    """Driving 2 m in steps of 5 cm, one pose unknown, then turning where it stands."""
    way = [planar_to_matrix(np.array([0.05 * i, 0.0, 0.0])) for i in range(41)]
    turns = [planar_to_matrix(np.array([2.0, 0.0, 0.3 * i])) for i in range(1, 9)]
    poses: list[Array | None] = [*way, *turns]
    poses[7] = None
    pairs = pairs_along_the_path(poses)
    assert len(pairs) == 16
    assert all(7 not in pair for pair in pairs)
    assert all(k <= 40 and 3 <= k - i <= 4 for i, k in pairs)


@pytest.mark.parametrize(
    ("scale", "word"), [(5.2, "1/5000 m"), (4.5, "by a factor of 0.222"), (1100.0, "millimetres")]
)
def test_a_suggestion_names_the_unit_only_where_it_is_one(scale: float, word: str) -> None:
    assert word in unit_suggestion(scale)
