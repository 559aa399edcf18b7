"""What people stated of maps holds in the map that they become."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from messages_in_memory import MemoryLog
from room_drive import drive
from test_localisation_commands import later

from formats.database import MemoryMap
from mapmyworld.api import Silent, build
from mapmyworld.config import Config
from mapmyworld.geometry.planar import planar_to_matrix
from mapmyworld.geometry.rigid import between
from mapmyworld.graph.edited_constraints import edits_from_json, edits_to_json
from mapmyworld.sessions import load_session_map, merge_maps
from mapmyworld.sessions.copying import copied_edits, place_session_maps
from mapmyworld.types import ConstraintKind, MapStore, Person
from mapmyworld.types.edits import Edit, EditAction

COVARIANCE = np.diag([1e-4] * 6)


def at(x: float, y: float, yaw: float) -> np.ndarray:
    return np.asarray(planar_to_matrix(np.array([x, y, yaw])))


def stated(action: EditAction, first: int, second: int, motion: np.ndarray | None = None) -> Edit:
    covariance = None if motion is None else COVARIANCE
    return Edit(action, first, second, f"{action} {first}", "", motion, covariance)


ONE = (
    stated(EditAction.PRIOR, 1, 1, at(0.0, 0.0, 0.0)),
    stated(EditAction.REJECT, 2, 3),
)
TWO = (
    stated(EditAction.PRIOR, 1, 1, at(5.0, 0.0, 1.0)),
    replace(stated(EditAction.PIN, 4, 4, at(5.0, 2.0, 1.5)), covariance=None),
    stated(EditAction.ACCEPT, 5, 6),
)


@pytest.fixture(scope="module")
def maps() -> tuple[MapStore, MapStore]:
    one = build(MemoryLog(drive(48, seed=1).entries)).map
    two = build(MemoryLog(later(drive(48, seed=2), 100, first=16).entries)).map
    one.put("edits", edits_to_json(ONE))
    two.put("edits", edits_to_json(TWO))
    return one, two


def test_edits_follow_their_nodes(maps: tuple[MapStore, MapStore]) -> None:
    """They were dropped."""
    session_maps = [load_session_map(name, store) for name, store in zip("ab", maps, strict=True)]
    count = session_maps[0].nodes[-1].id
    found = copied_edits(place_session_maps(session_maps, [np.eye(4), at(1.0, 0.0, 0.5)]))
    ends = [(edit.action, edit.from_id, edit.to_id) for edit in found]
    assert ends == [
        (EditAction.PRIOR, 1, 1),
        (EditAction.REJECT, 2, 3),
        (EditAction.ACCEPT, count + 5, count + 6),
        (EditAction.ADD, count + 1, count + 4),
    ]
    # Where the second unit's frame is in the map, nobody stated; how its two nodes lie, they did.
    together = found[-1]
    assert ONE[0].motion is not None
    assert together.motion is not None
    assert together.covariance is not None
    np.testing.assert_allclose(found[0].motion, ONE[0].motion)
    np.testing.assert_allclose(
        together.motion, between(at(5.0, 0.0, 1.0), at(5.0, 2.0, 1.5)), atol=1e-12
    )
    # An angle of 0.01 rad two metres away is 0.02 m: as much is added to the 0.01 m.
    sigmas = np.sqrt(np.linalg.eigvalsh(together.covariance[3:5, 3:5]))
    np.testing.assert_allclose(sigmas, [0.01, np.hypot(0.01, 0.02)], rtol=0.01)
    assert together.reason == "prior 1; pin 4"


@pytest.mark.slow
def test_a_merged_map_is_solved_with_the_edits(maps: tuple[MapStore, MapStore]) -> None:
    stores: list[MemoryMap] = []

    def new_store() -> MemoryMap:
        stores.append(MemoryMap())
        return stores[-1]

    two = maps[1]
    poses = two.poses()
    assert poses is not None
    true = between(poses.map_from_node[0], poses.map_from_node[8])
    two.put("edits", edits_to_json([stated(EditAction.ADD, 1, 9, true)]))
    session_maps = [load_session_map(name, store) for name, store in zip("ab", maps, strict=True)]
    merge_maps(session_maps, new_store, Config(), Silent())
    assert len(stores) == 1
    by_hand = [c for c in stores[0].constraints() if isinstance(c.source, Person)]
    kinds = {(c.kind, c.from_id) for c in by_hand}
    first = session_maps[0].nodes[-1].id
    assert kinds == {(ConstraintKind.PRIOR, 1), (ConstraintKind.USER, first + 1)}
    assert all(c.accepted for c in by_hand)
    assert len(edits_from_json(stores[0].get("edits"))) == 3
