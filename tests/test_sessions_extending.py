"""Several sessions in one map: in any order the same, and added one by one at their own cost."""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pytest
from database_samples import features, node, scan
from messages_in_memory import MemoryLog
from room_drive import Drive, drive
from test_localisation_commands import later

from formats.database import MemoryMap, open_store
from mapmyworld.api import Silent, build
from mapmyworld.config import Config
from mapmyworld.geometry.planar import between_planar, matrix_to_planar
from mapmyworld.mapping.occupancy import added_grid
from mapmyworld.sessions import extend_map, load_session_map, merge_maps
from mapmyworld.sessions.joining import session_places
from mapmyworld.sessions.session_maps import skeleton_of
from mapmyworld.stages.recognise import scan_loader
from mapmyworld.stages.solve_and_judge import solve_and_judge
from mapmyworld.types import ConstraintKind, Judged, MapStore, NodeData, OccupancyGrid
from mapmyworld.types.wording import reason_of

DRIVES: dict[str, Drive] = {
    "one": drive(48, seed=1),
    "two": later(drive(48, seed=2), 100, first=16),
    "three": later(drive(48, seed=3), 200, first=8),
}


@pytest.fixture(scope="module")
def maps() -> dict[str, MapStore]:
    return {name: build(MemoryLog(made.entries)).map for name, made in DRIVES.items()}


def merged(maps: dict[str, MapStore], names: Sequence[str]) -> MemoryMap:
    stores: list[MemoryMap] = []

    def new_store() -> MemoryMap:
        stores.append(MemoryMap())
        return stores[-1]

    made = merge_maps([load_session_map(n, maps[n]) for n in names], new_store, Config(), Silent())
    assert [m.sessions for m in made] == [len(names)]
    return stores[0]


def extended(maps: dict[str, MapStore], names: Sequence[str]) -> MemoryMap:
    """The first drive's map, with those named laid into it."""
    store = merged(maps, ["one"])
    done = extend_map(
        store, [load_session_map(n, maps[n]) for n in names], MemoryMap, Config(), Silent()
    )
    assert done is not None
    assert len(done.added) == len(names)
    assert done.links >= 2
    return store


def content(store: MapStore) -> tuple[bytes, ...]:
    """All that a map shows: poses of nodes and frames, verdicts, grid."""
    poses, frames, grid = store.poses(), store.frame_poses(), store.grid()
    assert poses is not None
    assert frames is not None
    assert grid is not None
    reported = [(c.from_id, c.to_id, c.kind, c.accepted, reason_of(c)) for c in store.constraints()]
    sessions = [(node.id, node.session) for node in store.nodes()]
    return (
        poses.map_from_node.tobytes(),
        frames.tobytes(),
        grid.log_odds.tobytes(),
        repr(reported).encode(),
        repr(sessions).encode(),
    )


def worst_error(store: MapStore, names: Sequence[str]) -> float:
    """Metres, of all frames."""
    truth = np.concatenate([DRIVES[name].truth for name in names])
    frames = store.frame_poses()
    assert frames is not None
    off = matrix_to_planar(frames) - between_planar(DRIVES["one"].truth[0], truth)
    return float(np.hypot(off[:, 0], off[:, 1]).max())


@pytest.mark.slow
def test_a_session_is_known_as_surely_as_its_closures_hold_it(maps: dict[str, MapStore]) -> None:
    """Not by the path alone: what a closure joins has not drifted apart."""
    store = merged(maps, ["one"])
    ids = [node.id for node in store.nodes()]
    exact = 1e12 * np.eye(6)
    closure = Judged(ids[0], ids[-1], ConstraintKind.LOOP_CLOSURE, np.eye(4), exact)

    def reach() -> float:
        nodes = session_places(load_session_map("one", store), Config()).nodes
        metres, _ = nodes.drift.reach(np.array([0]), np.array([len(nodes.ids) - 1]))[0]
        return float(metres)

    assert reach() > 1e-3
    store.add_constraints([closure])
    assert reach() < 1e-5


def test_three_logs_at_once_give_the_same_map_in_any_order(maps: dict[str, MapStore]) -> None:
    orders = list(itertools.permutations(DRIVES))[::2]
    found = {content(merged(maps, order)) for order in orders}
    assert len(orders) == 3
    assert len(found) == 1


@pytest.mark.slow
def test_appended_sessions_lie_right_and_the_map_stays_where_it_was(
    maps: dict[str, MapStore],
) -> None:
    alone, store = merged(maps, ["one"]), extended(maps, ["two", "three"])
    before, after = alone.poses(), store.poses()
    assert before is not None
    assert after is not None
    count = len(before.ids)
    assert after.map_from_node[:count].tobytes() == before.map_from_node.tobytes()
    assert sorted({node.session for node in store.nodes()}) == [0, 1, 2]
    assert worst_error(store, ["one", "two", "three"]) < 0.03
    assert after.covariances is not None
    assert len(after.covariances) == len(after.ids)
    assert np.all(np.linalg.eigvalsh(after.covariances) > -1e-12)
    listed = store.get("sessions")
    assert isinstance(listed, list)
    assert len(listed) == 3


@pytest.mark.slow
def test_appended_at_once_in_any_order_they_give_the_same_map(maps: dict[str, MapStore]) -> None:
    assert content(extended(maps, ["two", "three"])) == content(extended(maps, ["three", "two"]))


@pytest.mark.slow
def test_what_a_map_lacks_is_still_reported_when_a_session_was_laid_into_it(
    maps: dict[str, MapStore],
) -> None:
    """A partial map never passes as whole."""
    store = merged(maps, ["one"])
    with store.extend_stage("optimise", "reported"):
        lines = ["2 components", "a stated prior is contradicted"]
        store.put("solve", {"certainty": "", "losses": lines, "parted": lines[:1]})
    done = extend_map(store, [load_session_map("two", maps["two"])], MemoryMap, Config(), Silent())
    assert done is not None
    # Components are counted anew, in the map as it is now; here there is one.
    assert store.get("solve")["losses"] == lines[1:]


def test_an_extended_map_can_be_solved_anew(maps: dict[str, MapStore]) -> None:
    """As `optimise` and `edit` do: what was added must be there for the stages before."""
    store, config = extended(maps, ["two"]), Config()
    with store.write_stage("optimise", "again"):
        solve_and_judge(store, config, Silent(), scan_loader(store, config))
    session = {node.id: node.session for node in store.nodes()}
    across = [c for c in store.constraints() if session[c.from_id] != session[c.to_id]]
    assert sum(c.accepted for c in across) >= 3
    neighbours = [c for c in store.constraints() if c.kind == ConstraintKind.NEIGHBOUR]
    assert len(neighbours) == len(session) - 2
    assert worst_error(store, ["one", "two"]) < 0.03


@pytest.mark.slow
def test_the_skeleton_grows_with_the_area_and_not_with_the_drives(
    maps: dict[str, MapStore],
) -> None:
    alone = skeleton_of(load_session_map("one", merged(maps, ["one"])), MemoryMap(), Config())
    both = skeleton_of(
        load_session_map("all", extended(maps, ["two", "three"])), MemoryMap(), Config()
    )
    assert len(both.nodes) <= len(alone.nodes) + 2
    assert len(both.nodes) < len(merged(maps, ["one"]).nodes())


def grid(cells: list[list[float]], x: float, y: float) -> OccupancyGrid:
    return OccupancyGrid(np.array(cells, np.float32), 0.5, np.array([x, y]))


def test_grids_are_added_cell_by_cell() -> None:
    """The second lies one cell to the right of the first, and one below; unknown adds nothing."""
    nan = np.nan
    known, more = (
        grid([[1.0, nan], [2.0, -1.0]], 0.0, 0.0),
        grid([[3.0, 4.0], [nan, 0.5]], 0.5, -0.5),
    )
    total = added_grid(known, more, Config())
    assert total is not None
    assert total.origin.tolist() == [0.0, -0.5]
    limit = float(
        np.log(Config().mapping.clamp_probability / (1 - Config().mapping.clamp_probability))
    )
    expected = np.array([[nan, 3.0, 4.0], [1.0, nan, 0.5], [2.0, -1.0, nan]])
    assert np.allclose(total.log_odds, np.clip(expected, -limit, limit), equal_nan=True)
    assert added_grid(known, grid([[1.0]], 0.2, 0.0), Config()) is None


def test_twice_the_same_grid_is_twice_as_sure_up_to_the_limit() -> None:
    same = grid([[0.4, -0.3]], 0.0, 0.0)
    total = added_grid(same, same, Config())
    assert total is not None
    assert np.allclose(total.log_odds, [[0.8, -0.6]])
    for _ in range(10):
        total = added_grid(total, total, Config())
        assert total is not None
    clamp = Config().mapping.clamp_probability
    assert np.allclose(total.probabilities(), [[clamp, 1.0 - clamp]])


def test_nodes_with_features_and_much_data_are_stored(tmp_path: Path) -> None:
    """As sessions with images are merged."""
    with open_store(tmp_path / "map.db", create=True) as store, store.write_stage("track", ""):
        for number in range(1, 8):
            data = NodeData(scan=scan(number), features=features(number, words=False))
            store.add_node(node(number), data)
    with open_store(tmp_path / "map.db", read_only=True) as store:
        for number in range(1, 8):
            kept = store.node_data(number).features
            assert kept is not None
            assert np.array_equal(kept.pixels, features(number).pixels)
