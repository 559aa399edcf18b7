"""A camera and wheels, no laser: found in a known map by images alone, and sessions that join."""

from __future__ import annotations

import numpy as np
import pytest
from camera_drive import camera_log, circuit
from visual_rooms import Room

from formats.database import MemoryMap
from mapmyworld.api import Silent, build
from mapmyworld.config import Config
from mapmyworld.geometry.rigid import between
from mapmyworld.geometry.rotations import rotation_angle
from mapmyworld.localisation import localise_log
from mapmyworld.sessions import MergedMap, load_session_map, merge_maps
from mapmyworld.stages.plan_log import plan_log
from mapmyworld.types import MapStore
from mapmyworld.types.localisation import State

pytestmark = pytest.mark.slow

FIRST, SECOND = circuit(0, 400), circuit(100, 300)


@pytest.fixture(scope="module")
def maps() -> dict[str, MapStore]:
    """Two drives through one room, and one through a room with other pictures."""
    logs = {
        "one": camera_log(Room(), FIRST),
        "two": camera_log(Room(), SECOND, later_s=1000),
        "other": camera_log(Room(seed=7), SECOND, later_s=2000),
    }
    return {name: build(log).map for name, log in logs.items()}


def merged(maps: dict[str, MapStore], *names: str) -> tuple[list[MergedMap], list[MemoryMap]]:
    stores: list[MemoryMap] = []

    def new_store() -> MemoryMap:
        stores.append(MemoryMap())
        return stores[-1]

    session_maps = [load_session_map(name, maps[name]) for name in names]
    return merge_maps(session_maps, new_store, Config(), Silent()), stores


def test_a_camera_alone_is_found_and_tracked(maps: dict[str, MapStore]) -> None:
    log = camera_log(Room(), SECOND)
    plan = plan_log(log, Config(), Silent())
    found = localise_log(maps["one"], log, plan, Config(), Silent()).estimates
    claimed = np.array([e.state != State.LOST for e in found])
    off = between(between(FIRST[0], SECOND), np.stack([e.map_from_base for e in found]))
    metres = np.linalg.norm(off[:, :3, 3], axis=1)
    assert np.flatnonzero(claimed)[0] < 8
    assert claimed.mean() > 0.7
    assert np.median(metres[claimed]) < 0.02
    assert metres[claimed].max() < 0.1
    assert np.degrees(rotation_angle(off))[claimed].max() < 2.0
    assert State.RECOGNISED in {e.state for e in found}


def test_sessions_of_a_camera_join_in_any_order(maps: dict[str, MapStore]) -> None:
    results = [merged(maps, *names) for names in (("one", "two"), ("two", "one"))]
    for made, _ in results:
        assert [(m.names, m.sessions) for m in made] == [(("one", "two"), 2)]
        assert made[0].links >= 3
    poses = [stores[0].poses() for _, stores in results]
    assert poses[0] is not None
    assert poses[1] is not None
    assert poses[0].map_from_node.tobytes() == poses[1].map_from_node.tobytes()
    paths = results[0][1][0].frame_poses()
    assert paths is not None
    truth = between(FIRST[0], np.concatenate([FIRST, SECOND]))
    assert np.linalg.norm(between(truth, paths)[:, :3, 3], axis=1).max() < 0.05


def test_a_room_with_other_pictures_is_kept_apart(maps: dict[str, MapStore]) -> None:
    made, _ = merged(maps, "one", "other")
    assert [m.names for m in made] == [("one",), ("other",)]


def test_a_session_with_an_unknown_room_is_lost_rather_than_wrong(
    maps: dict[str, MapStore],
) -> None:
    log = camera_log(Room(seed=7), SECOND)
    plan = plan_log(log, Config(), Silent())
    found = localise_log(maps["one"], log, plan, Config(), Silent())
    assert found.share(State.LOST) == 1.0
