"""The MapStore contract, kept alike by the database and by the store of dictionaries."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np
import pytest
from database_samples import (
    constraint,
    features,
    fill,
    grid,
    image,
    node,
    pose,
    sample_constraints,
    sample_poses,
    scan,
    tracked_frames,
)
from memory_store import MemoryStore
from sample_verdicts import REJECTED

from formats.database import open_store
from mapmyworld.errors import MapError
from mapmyworld.types import (
    ConstraintKind,
    Judge,
    Judged,
    MapStore,
    NodeData,
    Poses,
    Scan,
    Verdict,
    Why,
)
from mapmyworld.types.wording import reason_of

Reopen = Callable[[], MapStore]


@pytest.fixture(params=["memory", "database"])
def store(request: pytest.FixtureRequest, tmp_path: Path) -> Iterator[MapStore]:
    if request.param == "memory":
        yield MemoryStore()
    else:
        with open_store(tmp_path / "map.db", create=True) as opened:
            yield opened


@pytest.fixture(params=["memory", "database"])
def filled(request: pytest.FixtureRequest, tmp_path: Path) -> Iterator[MapStore]:
    """A finished map, closed and opened again where it is a file."""
    if request.param == "memory":
        memory = MemoryStore()
        fill(memory)
        yield memory
        return
    with open_store(tmp_path / "map.db", create=True) as written:
        fill(written)
    with open_store(tmp_path / "map.db") as opened:
        yield opened


def same_scan(a: Scan, b: Scan, tolerance: float = 0.0) -> None:
    np.testing.assert_allclose(a.points, b.points, rtol=0, atol=tolerance)
    np.testing.assert_array_equal(a.missing, b.missing)
    np.testing.assert_array_equal(a.origin, b.origin)
    assert (a.range_max, a.angle_increment) == (b.range_max, b.angle_increment)


def same_constraint(a: Judged, b: Judged) -> None:
    assert (a.from_id, a.to_id, a.kind) == (b.from_id, b.to_id, b.kind)
    assert (a.source, a.verdicts) == (b.source, b.verdicts)
    np.testing.assert_array_equal(a.i_from_j, b.i_from_j)
    np.testing.assert_array_equal(a.information, b.information)


def test_nodes_come_back_in_double_precision(filled: MapStore) -> None:
    nodes = filled.nodes()
    assert [n.id for n in nodes] == [1, 2, 3]
    for n in nodes:
        expected = node(n.id)
        assert n.stamp_ns == expected.stamp_ns
        np.testing.assert_array_equal(n.odom_from_base, expected.odom_from_base)
        np.testing.assert_array_equal(n.tracked_from_base, expected.tracked_from_base)
    assert nodes[0].ground_truth is None
    assert nodes[1].ground_truth is not None
    np.testing.assert_array_equal(nodes[1].ground_truth, pose(502))


def test_node_data_come_back(filled: MapStore) -> None:
    data = filled.node_data(2)
    assert data.scan is not None
    same_scan(data.scan, scan(2), tolerance=1e-6)  # kept in the lidar's frame, as float32
    (kept,) = data.images
    original = image(2)
    assert kept.depth is not None
    assert original.depth is not None
    np.testing.assert_allclose(kept.depth.pixels(), original.depth.pixels(), atol=1e-6)
    assert kept.colour is not None
    assert original.colour is not None
    difference = np.abs(kept.colour.pixels().astype(float) - original.colour.pixels())
    assert difference.mean() < 3.0  # JPEG
    np.testing.assert_allclose(kept.camera.base_from_camera, original.camera.base_from_camera)
    assert data.features is not None
    for name in ("pixels", "points", "descriptors", "sizes", "angles", "octaves", "words"):
        np.testing.assert_array_equal(getattr(data.features, name), getattr(features(2), name))
    with pytest.raises((MapError, KeyError)):
        filled.node_data(99)


def test_scans_of_any_frames_come_back_exactly_and_ascending(filled: MapStore) -> None:
    assert [frame for frame, _ in filled.scans([5, 0, 3, 99, 3])] == [0, 3, 5]
    for frame, kept in filled.scans(np.arange(6)):
        same_scan(kept, scan(frame // 2 + 1 + 10 * (frame % 2)))
    assert list(filled.scans([])) == []


def test_graph_and_results_come_back_exactly(filled: MapStore) -> None:
    for kept, expected in zip(filled.constraints(), sample_constraints(), strict=True):
        same_constraint(kept, expected)
    poses, expected_poses = filled.poses(), sample_poses()
    assert poses is not None
    np.testing.assert_array_equal(poses.ids, expected_poses.ids)
    np.testing.assert_array_equal(poses.map_from_node, expected_poses.map_from_node)
    np.testing.assert_array_equal(poses.covariances, expected_poses.covariances)
    kept_grid = filled.grid()
    assert kept_grid is not None
    np.testing.assert_array_equal(kept_grid.log_odds, grid().log_odds)
    np.testing.assert_array_equal(kept_grid.origin, grid().origin)
    assert kept_grid.resolution == grid().resolution
    frame_poses = filled.frame_poses()
    assert frame_poses is not None
    np.testing.assert_array_equal(frame_poses, np.stack([pose(70 + i) for i in range(6)]))
    for name in ("stamps_ns", "node_ids", "node_from_frame", "is_node", "odom_from_base"):
        kept_array = getattr(filled.tracked_frames(), name)
        np.testing.assert_array_equal(kept_array, getattr(tracked_frames(), name))
    assert list(filled.words()) == list(range(1, 21))
    np.testing.assert_array_equal(filled.words()[3], features(1).descriptors[2])


def test_a_stage_is_done_only_with_the_same_inputs(store: MapStore) -> None:
    assert not store.stage_done("track", "a")
    with store.write_stage("track", "a"):
        store.add_node(node(1), NodeData())
    assert store.stage_done("track", "a")
    assert not store.stage_done("track", "b")


def test_a_stage_done_again_clears_it_and_all_that_follow(filled: MapStore) -> None:
    with filled.write_stage("optimise", "o2"):
        assert filled.poses() is None
        assert filled.grid() is None
        assert filled.get("summary") is None
    assert filled.stage_done("recognise", "r")
    assert not filled.stage_done("judge", "j")
    assert len(filled.nodes()) == 3
    with filled.write_stage("track", "t2"):
        pass
    assert filled.nodes() == ()
    assert filled.constraints() == ()
    assert list(filled.scans(range(9))) == []
    assert filled.words() == {}
    assert filled.get("plan") == {"scan": "/scan"}


def test_verdicts_of_a_later_stage_do_not_outlive_it(store: MapStore) -> None:
    """A stage done again must find the constraints as the stages before it left them."""
    first, second = (
        constraint(1, 2, ConstraintKind.NEIGHBOUR),
        constraint(1, 3, ConstraintKind.LOOP_CLOSURE),
    )
    rejected = second.judged(REJECTED)
    with store.write_stage("track", "t"):
        store.add_constraints([first])
    with store.write_stage("recognise", "r"):
        store.add_constraints([second])
    with store.write_stage("judge", "j"):
        store.judge([first, rejected])
    assert [c.accepted for c in store.constraints()] == [True, False]
    with store.write_stage("judge", "j2"):
        assert [c.accepted for c in store.constraints()] == [True, True]
    with store.write_stage("recognise", "r2"):
        assert len(store.constraints()) == 1
        assert store.constraints()[0].to_id == 2


def test_words_go_and_features_of_tracking_stay(store: MapStore) -> None:
    with store.write_stage("track", "t"):
        store.add_node(node(1), NodeData(features=features(1, words=False)))
    with store.write_stage("recognise", "r"):
        store.set_features(1, features(1))
        store.set_words({1: features(1).descriptors[0]})
    kept = store.node_data(1).features
    assert kept is not None
    assert kept.words is not None
    with store.write_stage("recognise", "r2"):
        kept = store.node_data(1).features
        assert kept is not None
        assert kept.words is None
        np.testing.assert_array_equal(kept.descriptors, features(1).descriptors)


def test_a_stage_left_by_an_error_keeps_its_work_and_is_not_done(store: MapStore) -> None:
    def break_off() -> None:
        with store.write_stage("track", "t"):
            store.add_node(node(1), NodeData(scan=scan()))
            store.add_scan(0, scan())
            raise RuntimeError("power")

    with pytest.raises(RuntimeError):
        break_off()
    assert not store.stage_done("track", "t")
    assert len(store.nodes()) == 1
    assert [frame for frame, _ in store.scans([0, 1])] == [0]


def test_values_of_any_json_shape_are_kept(store: MapStore) -> None:
    assert store.get("absent") is None
    for value in ({"a": [1, 2.5, None]}, "text", 3, False):
        store.put("key", value)
        assert store.get("key") == value


def test_without_tracked_frames_every_node_is_one(store: MapStore) -> None:
    with store.write_stage("track", "t"):
        store.add_node(node(1), NodeData())
        store.add_node(node(2), NodeData())
    frames = store.tracked_frames()
    assert frames.node_ids.tolist() == [1, 2]
    assert frames.is_node.all()
    np.testing.assert_array_equal(frames.node_from_frame, np.stack([np.eye(4)] * 2))


def test_poses_solved_again_without_covariances_have_none(filled: MapStore) -> None:
    with filled.write_stage("judge", "j"):
        poses = sample_poses()
        filled.set_poses(Poses(poses.ids, poses.map_from_node))
        kept = filled.poses()
        assert kept is not None
        assert kept.covariances is None
    with filled.write_stage("judge", "j2"):
        kept = filled.poses()  # those of the stage before
        assert kept is not None
        assert kept.covariances is not None


def test_a_superseded_measurement_comes_back_when_its_verdict_is_cleared(store: MapStore) -> None:
    old, new = (constraint(1, 2, ConstraintKind.NEIGHBOUR, i_from_j=pose(k)) for k in (5, 6))
    with store.write_stage("track", "t"):
        store.add_constraints([old])
    with store.write_stage("judge", "j"):
        store.judge([old.judged(Verdict(Judge.CAMERA, False, Why.CORRECTED)), new])
        (found,) = store.constraints()
        np.testing.assert_array_equal(found.i_from_j, new.i_from_j)
    with store.write_stage("judge", "j2"):
        (found,) = store.constraints()
        np.testing.assert_array_equal(found.i_from_j, old.i_from_j)


def test_verdicts_are_appended_and_the_last_one_counts(store: MapStore) -> None:
    """Nothing of the measurement, or of what was judged before, is written over."""
    found = constraint(1, 3, ConstraintKind.LOOP_CLOSURE)
    by_hand = Verdict(Judge.PERSON, True, Why.ACCEPTED_BY_HAND, note="{I was there}")
    with store.write_stage("recognise", "r"):
        store.add_constraints([found.judged(REJECTED)])
    with store.write_stage("optimise", "o"):
        store.judge([c.judged(by_hand) for c in store.constraints()])
        (judged,) = store.constraints()
    assert judged.accepted
    assert judged.verdicts == (*found.verdicts, REJECTED, by_hand)
    assert "evidence 12 points, 30 needed | by hand: accepted: {I was there}" in reason_of(judged)
    same_constraint(judged.before(Judge.PERSON), found.judged(REJECTED))
