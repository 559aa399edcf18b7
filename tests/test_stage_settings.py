"""A changed setting makes exactly those stages run again that read it, and what follows them."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Mapping
from typing import Any

import pytest
from conftest import ROOT
from settings_read import Beginning, settings_read

from formats.database import MemoryMap
from formats.logs import open_log
from mapmyworld.api import Silent, configured
from mapmyworld.config import Config
from mapmyworld.config.settings import Setting, apply_settings, list_settings
from mapmyworld.config.stage_settings import FIRST_READ, FIRST_READ_BY_PARTICLES, settings_of
from mapmyworld.pipeline import build_map
from mapmyworld.stages.record import StageRecord

APARTMENT = ROOT / "sample_logs" / "apartment.mcap"
GRAPH, PARTICLES = tuple(FIRST_READ), tuple(FIRST_READ_BY_PARTICLES)
NO_INPUT = {"threads"}  # changes nothing but the time
# Read by the store, or with what the logs below do not have: 3D lidars, markers of a given size,
# scans that are searched for, carried cameras, particles in a varying number.
UNSEEN = {
    "plan": {"sensing.cloud_lowest", "sensing.cloud_highest", "sensing.cloud_nearest"},
    "track": {
        "odometry.search_distance", "odometry.search_angle",
        "particles.count_min", "particles.kld_error",
        "registration.point_spacing", "registration.point_count", "registration.range_max",
    },
    "recognise": {"visual.marker_length"},
}  # fmt: skip
BY_STORE = ("storage.",)


def first_readers(read: Mapping[str, set[str]], stages: tuple[str, ...]) -> dict[str, str]:
    """Setting -> the first stage that read it."""
    return {name: stage for stage in reversed(stages) for name in read[stage] - NO_INPUT}


@pytest.fixture(scope="module")
def by_graph() -> dict[str, set[str]]:
    """What builds by the graph read of a log with laser, wheels and camera, or parts of it."""
    log, found = open_log([APARTMENT]), defaultdict[str, set[str]](set)
    asked = [
        (log, Config()),
        (log, configured(sensing__use_scans=False, visual__markers="4x4_50")),
        (log, configured(sensing__use_scans=False)),
        (
            Beginning(log, 8.0),
            configured(sensing__use_scans=False, sensing__odometry_topic="none"),
        ),
    ]
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(
            "mapmyworld.places.laser_sections._SECTION", 2.0
        )  # as if the drive were a long one
        for source, config in asked:
            for stage, names in settings_read(source, config).items():
                found[stage] |= names
    return found


def test_every_stage_names_the_settings_that_it_is_the_first_to_read(
    by_graph: dict[str, set[str]],
) -> None:
    found = first_readers(by_graph, GRAPH)
    for stage in GRAPH:
        named = set(settings_of(stage, Config()))
        read = {name for name, first in found.items() if first == stage}
        assert {name for name in read if not name.startswith(BY_STORE)} <= named, stage
        unread = {name for name in named - read if not name.startswith(BY_STORE)}
        assert unread <= UNSEEN.get(stage, set()), stage


def test_particles_read_what_their_stage_names() -> None:
    read = settings_read(Beginning(open_log([APARTMENT]), 6.0), Config(), "fastslam")
    found = first_readers(read, PARTICLES)
    for stage in PARTICLES:
        named = set(settings_of(stage, Config(), FIRST_READ_BY_PARTICLES))
        mine = {name for name, first in found.items() if first == stage}
        assert mine <= named, stage
        unread = {name for name in named - mine if not name.startswith(BY_STORE)}
        assert unread <= UNSEEN.get(stage, set())


def other(setting: Setting) -> Any:
    """Another value that is allowed."""
    if isinstance(setting.value, bool):
        return not setting.value
    if setting.choices:
        return next(word for word in setting.choices if word != setting.value)
    if isinstance(setting.value, str):
        return f"{setting.value}x"
    for value in (setting.value + 1, setting.value * 0.9, setting.value * 1.01):
        try:
            apply_settings(Config(), {setting.name: value})
        except Exception:
            continue
        return type(setting.value)(value)
    raise AssertionError(setting.name)


@pytest.mark.parametrize("method", ["graph", "fastslam"])
def test_a_changed_setting_runs_its_stage_and_all_later_ones_again(
    method: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    log, store = open_log([APARTMENT]), MemoryMap()
    monkeypatch.setattr(type(log), "content_hash", lambda _: "bytes")
    ran: list[str] = []
    run = StageRecord.run

    def noted(record: StageRecord, stage: str, inputs: tuple[Any, ...], _: object) -> None:
        run(record, stage, inputs, lambda: ran.append(stage))

    monkeypatch.setattr(StageRecord, "run", noted)
    first_read = FIRST_READ if method == "graph" else FIRST_READ_BY_PARTICLES

    def built(config: Config) -> list[str]:
        ran.clear()
        build_map(log, store, config, Silent(), method=method)
        return list(ran)

    assert built(Config()) == list(first_read)
    assert built(Config()) == []
    for setting in list_settings():
        if setting.name == "places.vocabulary":
            continue  # its words are the input, whatever their file is called
        changed = apply_settings(Config(), {setting.name: other(setting)})
        names = [settings_of(stage, changed, first_read) for stage in first_read]
        owners = [k for k, named in enumerate(names) if setting.name in named]
        assert len(owners) <= 1, setting.name
        again = list(first_read)[owners[0] :] if owners else []
        assert built(changed) == again, setting.name
        assert built(Config()) == again, setting.name
    store.put("edits", [{"action": "reject"}])
    assert built(Config()) == (["optimise", "map"] if method == "graph" else [])
