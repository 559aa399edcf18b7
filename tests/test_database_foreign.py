"""Databases of RTAB-Map's as maps: two that it wrote, and odd ones made for the purpose."""

from __future__ import annotations

import sqlite3
from pathlib import Path

import numpy as np
import pytest
import rtabmap_decoder as decode
from foreign_database import (
    add_nodes,
    ahead,
    floats,
    information,
    insert,
    matrix,
    rtabmap_file,
    scan_info,
)

from formats.database import open_store
from formats.trajectory_files import read_trajectory
from mapmyworld.errors import MapError
from mapmyworld.types import ConstraintKind

LOGS = ("fr079_laser", "freiburg1_rpy")


@pytest.mark.parametrize("name", LOGS)
def test_poses_are_those_of_rtabmaps_own_exporter(data: Path, name: str) -> None:
    with open_store(data / f"rtabmap/{name}.db", read_only=True) as store:
        poses, stamps = store.poses(), {node.id: node.stamp_ns for node in store.nodes()}
    assert poses is not None
    theirs = read_trajectory(data / f"rtabmap/{name}.poses.tum")
    ours = dict(zip((stamps[int(i)] for i in poses.ids), poses.map_from_node, strict=True))
    assert len(ours) == len(theirs.stamps_ns)
    for stamp_ns, pose in zip(theirs.stamps_ns.tolist(), theirs.poses, strict=True):
        np.testing.assert_allclose(ours[stamp_ns], pose, rtol=0, atol=1e-5)


def test_every_node_of_the_laser_database(data: Path) -> None:
    """Counts as rtabmap-info indicates them; scans as the independent decoder reads them."""
    path = data / "rtabmap/fr079_laser.db"
    decoder = decode.Decoder(path)
    rows = {row["id"]: row for row in decoder.rows("Data")}
    with open_store(path, read_only=True) as store:
        assert len(store.nodes()) == 252  # of 260, eight of which were merged away
        kinds = [c.kind for c in store.constraints()]
        assert kinds.count(ConstraintKind.NEIGHBOUR) == 251
        assert kinds.count(ConstraintKind.PROXIMITY) == 104
        assert len(kinds) == 355
        assert store.problems == ()
        for node in store.nodes():
            scan = store.node_data(node.id).scan
            info = decode.scan_info(rows[node.id]["scan_info"])
            points = decode.matrix(rows[node.id]["scan"])[0]
            assert scan is not None
            np.testing.assert_allclose(scan.points, points + info["mount"][:2, 3], atol=1e-6)
            assert scan.range_max == info["range_max"]
    decoder.close()


def test_every_node_of_the_camera_database(data: Path) -> None:
    path = data / "rtabmap/freiburg1_rpy.db"
    decoder = decode.Decoder(path)
    rows = {row["id"]: row for row in decoder.rows("Data")}
    with open_store(path, read_only=True) as store:
        assert len(store.nodes()) == 47
        kinds = [c.kind for c in store.constraints()]
        assert kinds.count(ConstraintKind.NEIGHBOUR) == 46
        assert kinds.count(ConstraintKind.PROXIMITY) == 2
        words = store.words()
        assert len(words) == 16276
        assert {w.shape for w in words.values()} == {(32,)}
        count = 0
        for node in store.nodes():
            data_of_node = store.node_data(node.id)
            (image,) = data_of_node.images
            assert image.colour is not None
            assert image.depth is not None
            if node.id % 10 == 1:  # decoding by the letter is slow
                row = rows[node.id]
                pixels = decode.picture(row["image"])
                np.testing.assert_array_equal(image.colour.pixels(), pixels)
                metres = decode.depth_metres(row["depth"])
                np.testing.assert_allclose(image.depth.pixels(), metres, atol=1e-6)
            assert node.ground_truth is not None
            assert data_of_node.features is not None
            assert data_of_node.features.descriptors.shape[1] == 32
            count += len(data_of_node.features.pixels)
        assert count == 44459
        assert image.camera.intrinsics[0, 0] == 517.3
    decoder.close()


def test_links_are_turned_forward_and_kept_once(tmp_path: Path) -> None:
    with rtabmap_file(tmp_path / "r.db") as sqlite:
        add_nodes(sqlite, 3)
        for from_id, to_id, step in ((2, 1, -1.0), (1, 2, 1.0), (2, 3, 1.0), (3, 2, -1.0)):
            link(sqlite, from_id, to_id, 0, ahead(step))
        link(sqlite, 3, 1, 1, ahead(-2.0))
        link(sqlite, 1, 3, 3, ahead(2.5))
        link(sqlite, 2, 2, 7, ahead(9.0))
        link(sqlite, 2, -4, 8, ahead(3.0))
        link(sqlite, 2, 2, 9, ahead(0.0))  # gravity: not a constraint of ours
        link(sqlite, 1, 3, 2, floats(*[0.0] * 12))  # of a node that was merged away
    with open_store(tmp_path / "r.db") as store:
        found = [(c.from_id, c.to_id, c.kind, c.i_from_j[0, 3]) for c in store.constraints()]
        assert found == [
            (1, 2, ConstraintKind.NEIGHBOUR, 1.0),
            (2, 3, ConstraintKind.NEIGHBOUR, 1.0),
            (1, 3, ConstraintKind.LOOP_CLOSURE, 2.0),
            (1, 3, ConstraintKind.PROXIMITY, 2.5),
            (2, 2, ConstraintKind.PRIOR, 9.0),
            (2, -4, ConstraintKind.LANDMARK, 3.0),
        ]
        assert store.problems == ()
        np.testing.assert_array_equal(
            np.diag(store.constraints()[0].information), [4, 5, 6, 1, 2, 3]
        )


def link(sqlite: sqlite3.Connection, a: int, b: int, kind: int, motion: bytes) -> None:
    insert(
        sqlite,
        "Link",
        from_id=a,
        to_id=b,
        type=kind,
        information_matrix=information(),
        transform=motion,
    )


def test_links_that_cannot_be_are_left_out_and_reported(tmp_path: Path) -> None:
    with rtabmap_file(tmp_path / "r.db") as sqlite:
        add_nodes(sqlite, 2)
        link(sqlite, 1, 2, 0, ahead(1.0))
        link(sqlite, 1, 1, 0, ahead(1.0))
        link(sqlite, 1, 77, 1, ahead(1.0))
        link(sqlite, 1, 2, 55, ahead(1.0))
        link(sqlite, 1, 2, 1, b"short")
        link(sqlite, 1, 2, 2, floats(*[float("nan")] * 12))
        wrong = {"from_id": 1, "to_id": 2, "type": 4, "transform": ahead(1.0)}
        insert(sqlite, "Link", information_matrix=information(1, 1, 1, 0, 1, 1), **wrong)
        insert(sqlite, "Link", information_matrix=b"few", **wrong)
    with open_store(tmp_path / "r.db") as store:
        assert len(store.constraints()) == 1
        problems = store.problems
    expected = ("itself", "no such node", "unknown type", "48 bytes", "not finite", "positive")
    assert len(problems) == len(expected) + 1
    for words, problem in zip((*expected, "288 bytes"), problems, strict=True):
        assert words in problem


def test_a_file_without_optimised_poses_or_words(tmp_path: Path) -> None:
    """As a crash leaves it: everything but the results."""
    with rtabmap_file(tmp_path / "r.db") as sqlite:
        add_nodes(sqlite, 2)
        values = (1, 12, 10.0, 20.0, 7, -1.0, 0.5, 0, None, None, None, 2, b"\1\2")
        sqlite.execute(f"INSERT INTO Feature VALUES ({','.join('?' * 13)})", values)
    with open_store(tmp_path / "r.db") as store:
        assert store.poses() is None
        assert store.grid() is None
        assert store.words() == {}
        data = store.node_data(1)
        assert data.scan is None
        assert data.images == ()
        assert data.features is not None
        assert np.isnan(data.features.points).all()
        assert data.features.words is not None
        assert data.features.words.tolist() == [12]
        assert store.node_data(2).features is None


def test_a_stored_grid(tmp_path: Path) -> None:
    cells = np.array([[[0], [100]], [[-1], [100]], [[0], [0]]], np.int8)
    with rtabmap_file(tmp_path / "r.db") as sqlite:
        add_nodes(sqlite, 1)
        sqlite.execute("UPDATE Admin SET opt_map = ?, opt_map_x_min = -1.5", (matrix(cells),))
        sqlite.execute("UPDATE Admin SET opt_map_y_min = 2, opt_map_resolution = 0.1")
    with open_store(tmp_path / "r.db") as store:
        grid = store.grid()
    assert grid is not None
    np.testing.assert_array_equal(grid.trinary(), cells[:, :, 0])
    assert grid.origin.tolist() == [-1.5, 2.0]
    assert grid.resolution == 0.1


def test_optimised_poses_of_some_nodes_and_landmarks(tmp_path: Path) -> None:
    ids = np.array([-5, 1, 3], np.int32).reshape(1, 3, 1)
    poses = np.frombuffer(ahead(5) + ahead(1) + ahead(3), "<f4").reshape(1, 36, 1)
    with rtabmap_file(tmp_path / "r.db") as sqlite:
        add_nodes(sqlite, 3)
        results = (matrix(ids), matrix(poses))
        sqlite.execute("UPDATE Admin SET opt_ids = ?, opt_poses = ?", results)
    with open_store(tmp_path / "r.db") as store:
        solved = store.poses()
    assert solved is not None
    assert solved.ids.tolist() == [1, 3, -5]
    assert solved.map_from_node[:, 0, 3].tolist() == [1, 3, 5]


@pytest.mark.parametrize(
    ("kind", "channels", "planar"),
    [
        *((kind, channels, True) for kind, channels in ((1, 2), (2, 3), (3, 5), (4, 6))),
        *((kind, channels, False) for kind, channels in ((5, 3), (6, 4), (7, 4), (10, 7), (12, 6))),
        *((0, channels, channels in (2, 5)) for channels in (2, 3, 4, 5, 6, 7)),
    ],
)
def test_scan_formats_organised_with_nan(
    tmp_path: Path, kind: int, channels: int, planar: bool
) -> None:
    values = np.arange(4 * 5 * channels, dtype=np.float32).reshape(4, 5, channels)
    values[1, 2] = np.nan
    with rtabmap_file(tmp_path / "r.db") as sqlite:
        add_nodes(sqlite, 1)
        insert(sqlite, "Data", id=1, scan=matrix(values), scan_info=scan_info(kind))
    with open_store(tmp_path / "r.db") as store:
        data = store.node_data(1)
    kept = np.delete(values.reshape(-1, channels), 7, axis=0)
    if planar:
        assert data.cloud is None
        assert data.scan is not None
        np.testing.assert_array_equal(data.scan.points, kept[:, :2])
    else:
        assert data.scan is None
        assert data.cloud is not None
        np.testing.assert_array_equal(data.cloud, kept[:, :3] + [0, 0, 1])


@pytest.mark.parametrize(
    ("version", "words"),
    [
        ("0.11.8", "rtabmap-reprocess"),
        ("0.17.6", "rtabmap-reprocess"),
        ("", "does not say"),
        ("banana", "does not say"),
    ],
)
def test_versions_that_cannot_be_read(tmp_path: Path, version: str, words: str) -> None:
    with rtabmap_file(tmp_path / "r.db", version) as sqlite:
        add_nodes(sqlite, 1)
    with pytest.raises(MapError, match=words) as caught:
        open_store(tmp_path / "r.db")
    assert "\n" not in str(caught.value)


def test_merged_and_intermediate_nodes_and_sessions(tmp_path: Path) -> None:
    with rtabmap_file(tmp_path / "r.db") as sqlite:
        add_nodes(sqlite, 5)
        sqlite.execute("UPDATE Node SET weight = -9 WHERE id = 2")
        sqlite.execute("UPDATE Node SET weight = -1 WHERE id = 3")
        sqlite.execute("UPDATE Node SET map_id = 1 WHERE id > 3")
        sqlite.execute("UPDATE Node SET pose = NULL WHERE id = 5")
    with open_store(tmp_path / "r.db") as store:
        nodes = store.nodes()
        assert [(n.id, n.session, n.weight) for n in nodes] == [(1, 0, 0), (3, 0, -1), (4, 1, 0)]
        assert nodes[0].stamp_ns == 10_500_000_000
        assert store.problems == ("node 5 has no odometry pose: it is left out",)
        assert store.tracked_frames().node_ids.tolist() == [1, 3, 4]
