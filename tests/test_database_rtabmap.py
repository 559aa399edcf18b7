"""What we write, read back value by value by a decoder that shares nothing with the writer.

The rules are those whose breach makes RTAB-Map's own tools abort.
"""

from __future__ import annotations

import sqlite3
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import rtabmap_decoder as decode
from database_samples import (
    OPTICAL,
    START_NS,
    camera,
    constraint,
    features,
    fill,
    grid,
    image,
    node,
    picture,
    pose,
    sample_constraints,
    sample_poses,
    scan,
)

from formats.database import open_store
from formats.database.connection import APPLICATION_ID
from formats.database.image_blobs import encode_picture
from mapmyworld.types import ConstraintKind, NodeData, RgbdImage

# RTAB-Map's order of a tangent (translation first) in ours (rotation first).
SWAP = [3, 4, 5, 0, 1, 2]


@pytest.fixture(scope="module")
def written(tmp_path_factory: pytest.TempPathFactory) -> Iterator[decode.Decoder]:
    path = tmp_path_factory.mktemp("map") / "map.db"
    with open_store(path, create=True) as store:
        fill(store)
    decoder = decode.Decoder(path)
    yield decoder
    decoder.close()


def test_file_is_as_the_tools_demand(written: decode.Decoder) -> None:
    pragma = {
        name: written.sqlite.execute(f"PRAGMA {name}").fetchone()[0]
        for name in ("journal_mode", "user_version", "application_id", "integrity_check")
    }
    assert pragma == {
        "journal_mode": "delete",
        "user_version": 0,
        "application_id": APPLICATION_ID,  # RTAB-Map looks at none
        "integrity_check": "ok",
    }
    objects = written.sqlite.execute("SELECT type, name FROM sqlite_master")
    found = {(kind, name) for kind, name in objects if not name.startswith("sqlite_")}
    tables = [
        "Node",
        "Data",
        "Link",
        "Word",
        "Feature",
        "GlobalDescriptor",
        "Info",
        "Statistics",
        "Admin",
    ]
    indexes = [
        "Node_id",
        "Feature_node_id",
        "GlobalDescriptor_node_id",
        "Link_from_id",
        "node_label",
    ]
    triggers = ["insert_Feature"] + [
        f"insert_{t}_timeEnter" for t in ["Node", "Data", "Word", "Info"]
    ]
    assert {("table", t) for t in tables} <= found
    assert {("index", f"IDX_{i}") for i in [*indexes, "Statistics_id"]} <= found
    assert {("trigger", t) for t in triggers} <= found


def test_columns_are_those_of_the_stated_version(written: decode.Decoder, data: Path) -> None:
    """The same as in RTAB-Map's newest file but for what came after 0.20.0."""
    later = {"Data": {"depth_confidence"}, "Admin": {"dictionary_index"}}
    theirs = sqlite3.connect(f"file:{data / 'rtabmap/freiburg1_rpy.db'}?mode=ro", uri=True)
    for (table,) in theirs.execute("SELECT name FROM sqlite_master WHERE type = 'table'"):
        query = f"SELECT name, type, \"notnull\", pk FROM pragma_table_info('{table}')"
        expected = [tuple(row) for row in theirs.execute(query)]
        expected = [row for row in expected if row[0] not in later.get(table, set())]
        assert [tuple(row) for row in written.sqlite.execute(query)] == expected
    theirs.close()


def test_admin_and_info_have_one_row_each(written: decode.Decoder) -> None:
    admin, info = written.only("Admin"), written.only("Info")
    assert admin["version"] == "0.20.0"
    assert info["parameters"]
    parameters = written.parameters()
    assert parameters["RGBD/CreateOccupancyGrid"] == "true"
    nodes = written.rows("Node")
    assert all(row["time_enter"] >= info["time_enter"] for row in [*nodes, *written.rows("Word")])
    assert nodes[0]["time_enter"] == "2011-05-10 12:40:29"  # the log's start, in UTC


def test_nodes_keep_session_stamp_odometry_truth_and_velocity(written: decode.Decoder) -> None:
    rows = written.rows("Node")
    assert [row["label"] for row in rows] == ["map0", None, None]
    for row in rows:
        expected = node(row["id"])
        assert row["map_id"] == 0
        assert row["weight"] == 0
        assert row["stamp"] == expected.stamp_ns * 1e-9
        np.testing.assert_allclose(
            decode.transform(row["pose"]), expected.odom_from_base, rtol=0, atol=1e-6
        )
    assert rows[0]["ground_truth_pose"] is None
    np.testing.assert_allclose(decode.transform(rows[2]["ground_truth_pose"]), pose(503), atol=1e-6)
    assert rows[0]["velocity"] is None
    moved = np.linalg.inv(pose(1)) @ pose(2)  # in the one second between nodes
    velocity = np.frombuffer(rows[1]["velocity"], "<f4")
    assert velocity.shape == (6,)
    np.testing.assert_allclose(velocity[:3], moved[:3, 3], atol=1e-5)
    yaw = np.arctan2(moved[1, 0], moved[0, 0])
    assert velocity[5] == pytest.approx(yaw, abs=1e-5)


def test_images_depth_and_calibration_are_kept(written: decode.Decoder) -> None:
    for row in written.rows("Data"):
        original = image(row["id"])
        assert original.colour is not None
        assert original.depth is not None
        assert row["image"].startswith(b"\xff\xd8\xff")
        colour = decode.picture(row["image"]).astype(float)
        assert np.abs(colour - original.colour.pixels()).mean() < 3.0
        assert row["depth"].startswith(b"\x89PNG")
        np.testing.assert_allclose(
            decode.depth_metres(row["depth"]), original.depth.pixels(), atol=1e-6
        )
        (calibration,) = decode.calibrations(row["calibration"])
        assert calibration["size"] == (64, 48)
        np.testing.assert_array_equal(calibration["K"], camera().intrinsics.ravel())
        np.testing.assert_array_equal(
            calibration["P"].reshape(3, 4), np.column_stack([camera().intrinsics, np.zeros(3)])
        )
        np.testing.assert_allclose(calibration["L"], OPTICAL, atol=1e-7)
        assert row["time_enter"] is None


def test_scans_lie_in_the_lidars_frame(written: decode.Decoder) -> None:
    for row in written.rows("Data"):
        original, info = scan(row["id"]), decode.scan_info(row["scan_info"])
        points = decode.matrix(row["scan"])
        assert points.dtype == np.float32
        assert points.shape == (1, len(original.points), 2)
        assert info["format"] == 1
        assert info["range_max"] == 8.0
        assert info["range_max"] > info["range_min"]
        assert info["angle_min"] < info["angle_max"]
        assert info["most"] >= len(original.points)
        lifted = np.column_stack([points[0], np.zeros(len(points[0])), np.ones(len(points[0]))])
        in_base = lifted @ info["mount"].T
        np.testing.assert_allclose(in_base[:, :2], original.points, atol=2e-6)


def test_accepted_constraints_are_links_both_ways(written: decode.Decoder) -> None:
    numbers = {"neighbour": 0, "loop_closure": 1, "proximity": 2, "user": 4, "prior": 7}
    numbers["landmark"] = 8
    links = {(r["from_id"], r["to_id"], r["type"]): r for r in written.rows("Link")}
    accepted = [c for c in sample_constraints() if c.accepted]
    both_ways = [c for c in accepted if c.kind not in ("prior", "landmark")]
    assert len(links) == len(written.rows("Link")) == len(accepted) + len(both_ways)
    for c in accepted:
        forward = links[c.from_id, c.to_id, numbers[c.kind]]
        np.testing.assert_allclose(decode.transform(forward["transform"]), c.i_from_j, atol=1e-6)
        expected = c.information[np.ix_(SWAP, SWAP)]
        np.testing.assert_array_equal(decode.information(forward["information_matrix"]), expected)
        if c in both_ways:
            backward = links[c.to_id, c.from_id, numbers[c.kind]]
            np.testing.assert_allclose(
                decode.transform(backward["transform"]), np.linalg.inv(c.i_from_j), atol=1e-5
            )
            assert backward["information_matrix"] == forward["information_matrix"]


def test_features_and_words(written: decode.Decoder) -> None:
    words = {row["id"]: row for row in written.rows("Word")}
    assert sorted(words) == list(range(1, 21))
    for row in words.values():
        assert row["descriptor_size"] == len(row["descriptor"]) == 32
        assert row["descriptor"] == features(1).descriptors[row["id"] - 1].tobytes()
    found = [row for row in written.rows("Feature") if row["node_id"] == 2]
    expected = features(2)
    assert expected.words is not None
    assert len(found) == len(expected.pixels)
    for i, row in enumerate(found):
        assert (row["pos_x"], row["pos_y"]) == tuple(expected.pixels[i].tolist())
        assert row["descriptor"] == expected.descriptors[i].tobytes()
        assert row["size"] == 31
        assert row["dir"] == expected.angles[i]
        assert row["octave"] == expected.octaves[i]
        point = [row["depth_x"], row["depth_y"], row["depth_z"]]
        if np.isnan(expected.points[i]).any():
            assert point == [None] * 3
        else:
            assert point == expected.points[i].tolist()
        assert row["word_id"] == expected.words[i] if expected.words[i] else row["word_id"] < 0
    alone = [row["word_id"] for row in found if row["word_id"] < 0]
    assert len(set(alone)) == len(alone)


def test_solved_poses_and_grid_are_those_of_the_map(written: decode.Decoder) -> None:
    optimised, expected = written.optimised(), sample_poses()
    assert list(optimised) == sorted(expected.ids.tolist())
    for node_id, solved in zip(expected.ids, expected.map_from_node, strict=True):
        np.testing.assert_allclose(optimised[int(node_id)], solved, atol=1e-6)
    admin = written.only("Admin")
    np.testing.assert_allclose(
        decode.transform(admin["opt_last_localization"]), expected.map_from_node[2], atol=1e-6
    )
    cells = decode.matrix(admin["opt_map"])
    assert cells.dtype == np.int8
    np.testing.assert_array_equal(cells[:, :, 0], grid().trinary())
    corner = (admin["opt_map_x_min"], admin["opt_map_y_min"], admin["opt_map_resolution"])
    assert corner == (-1.25, 3.5, 0.05)


def test_no_label_is_empty_and_sessions_start_with_one(tmp_path: Path) -> None:
    with open_store(tmp_path / "map.db", create=True) as store:
        for number, session in ((1, 0), (2, 0), (3, 1), (4, 1)):
            store.add_node(node(number, session), NodeData())
    decoder = decode.Decoder(tmp_path / "map.db")
    rows = decoder.rows("Node")
    assert [row["label"] for row in rows] == ["map0", None, "map1", None]
    assert [row["map_id"] for row in rows] == [0, 0, 1, 1]
    assert rows[2]["velocity"] is None  # an odometry of its own: no motion since node 2
    decoder.close()


def test_information_is_written_exactly_symmetric(tmp_path: Path) -> None:
    """RTAB-Map's `rtabmap-report` gives up at a matrix that differs from its transpose by a bit."""
    root = np.random.default_rng(3).normal(size=(6, 6))
    turned = np.linalg.inv(root @ root.T + np.eye(6))
    assert (turned != turned.T).any()  # as products and inverses leave it
    with open_store(tmp_path / "map.db", create=True) as store:
        for number in (1, 2):
            store.add_node(node(number), NodeData())
        store.add_constraints([constraint(1, 2, ConstraintKind.NEIGHBOUR, information=turned)])
    with open_store(tmp_path / "map.db", read_only=True) as store:
        kept = store.constraints()[0].information
    decoder = decode.Decoder(tmp_path / "map.db")
    links = [decode.information(row["information_matrix"]) for row in decoder.rows("Link")]
    decoder.close()
    for matrix in links:
        np.testing.assert_array_equal(matrix, matrix.T)
    # What was measured is read as it was: a build that is resumed must come to the same poses.
    np.testing.assert_array_equal(kept, turned)


def test_information_that_rtabmap_refuses_is_made_weak(tmp_path: Path) -> None:
    """A prior on position alone has no information on the angles; RTAB-Map wants it positive."""
    flat = np.diag([0.0, 0, 0, 4, 4, 0])
    with open_store(tmp_path / "map.db", create=True) as store:
        store.add_node(node(1), NodeData())
        store.add_constraints([constraint(1, 1, ConstraintKind.PRIOR, information=flat)])
        kept = store.constraints()[0].information
    np.testing.assert_array_equal(kept, flat)
    decoder = decode.Decoder(tmp_path / "map.db")
    (row,) = decoder.rows("Link")
    stored = np.diag(decode.information(row["information_matrix"]))
    np.testing.assert_allclose(stored, [4, 4, 1 / 9999, 1 / 9999, 1 / 9999, 1 / 9999])
    decoder.close()


def one_node(tmp_path: Path, data: NodeData, **options: Any) -> dict[str, Any]:
    """The Data row of a map of one node."""
    with open_store(tmp_path / "map.db", create=True, **options) as store:
        store.add_node(node(1), data)
    decoder = decode.Decoder(tmp_path / "map.db")
    row = decoder.only("Data")
    decoder.close()
    return row


@pytest.mark.parametrize("codec", ["png", "float"])
def test_depth_codecs(tmp_path: Path, codec: str) -> None:
    pixels = np.random.default_rng(2).uniform(0, 70, (48, 64)).astype(np.float32)
    pixels[::7] = 0
    pair = RgbdImage(camera(), None, picture(pixels, "32FC1"))
    row = one_node(tmp_path, NodeData(images=(pair,)), depth_codec=codec)
    metres = decode.depth_metres(row["depth"])
    if codec == "float":
        np.testing.assert_array_equal(metres, pixels)
    else:  # beyond 65.535 m there is no depth
        expected = np.where(pixels > 65.535, 0, pixels)
        np.testing.assert_allclose(metres, expected, rtol=0, atol=5.1e-4)
    assert row["image"] is None


def test_recorded_jpeg_is_kept_byte_for_byte(tmp_path: Path) -> None:
    colour = np.random.default_rng(0).integers(0, 255, (48, 64, 3), dtype=np.uint8)
    jpeg = encode_picture(colour, "jpeg", 30)
    pair = RgbdImage(camera(), picture(colour, "rgb8", encoded=jpeg), None)
    assert one_node(tmp_path, NodeData(images=(pair,)))["image"] == jpeg


def test_several_cameras_stand_side_by_side(tmp_path: Path) -> None:
    left, right = image(1), image(2, START_NS + 7)
    with open_store(tmp_path / "map.db", create=True) as store:
        store.add_node(node(1), NodeData(images=(left, right)))
        kept = store.node_data(1).images
    assert [k.colour.stamp_ns for k in kept if k.colour] == [START_NS, START_NS + 7]
    for original, back in zip((left, right), kept, strict=True):
        assert original.depth is not None
        assert back.depth is not None
        np.testing.assert_allclose(back.depth.pixels(), original.depth.pixels(), atol=1e-6)
    decoder = decode.Decoder(tmp_path / "map.db")
    row = decoder.only("Data")
    assert decode.picture(row["image"]).shape == (48, 128, 3)
    assert decode.depth_metres(row["depth"]).shape == (48, 128)
    assert len(decode.calibrations(row["calibration"])) == 2
    decoder.close()


@pytest.mark.parametrize(
    ("model", "given", "stored"),
    [
        ("plumb_bob", [0.1, -0.2, 0.001, 0.002, 0.3], [0.1, -0.2, 0.001, 0.002, 0.3]),
        ("plumb_bob", [0.0] * 5, []),
        ("equidistant", [0.1, 0.2, 0.3, 0.4], [0.1, 0.2, 0, 0, 0.3, 0.4]),
        ("rational_polynomial", [0.1] * 8, [0.1] * 8),
    ],
)
def test_a_lens_is_stored_at_a_length_that_rtabmap_knows(
    tmp_path: Path, model: str, given: list[float], stored: list[float]
) -> None:
    lens = camera(distortion_model=model, distortion=np.array(given))
    pair = RgbdImage(lens, image().colour, None)
    row = one_node(tmp_path, NodeData(images=(pair,)))
    (record,) = decode.calibrations(row["calibration"])
    assert record["D"].tolist() == stored
    with open_store(tmp_path / "map.db") as store:
        back = store.node_data(1).images[0].camera
    if any(given):
        assert back.distortion_model == model
        assert back.distortion.tolist() == given


def test_a_3d_scan_keeps_every_point(tmp_path: Path) -> None:
    cloud = np.random.default_rng(0).normal(size=(500, 3)).astype(np.float32)
    row = one_node(tmp_path, NodeData(cloud=cloud))
    np.testing.assert_array_equal(decode.matrix(row["scan"])[0], cloud)
    info = decode.scan_info(row["scan_info"])
    assert info["format"] == 5
    assert info["increment"] == 0
    np.testing.assert_array_equal(info["mount"], np.eye(4))
    with open_store(tmp_path / "map.db") as store:
        kept = store.node_data(1)
    assert kept.scan is None
    np.testing.assert_array_equal(kept.cloud, cloud)


def test_3d_and_planar_scan_of_one_node_are_both_kept(tmp_path: Path) -> None:
    cloud = np.random.default_rng(0).normal(size=(50, 3)).astype(np.float32)
    with open_store(tmp_path / "map.db", create=True) as store:
        store.add_node(node(1), NodeData(scan=scan(1), cloud=cloud))
        kept = store.node_data(1)
    assert kept.scan is not None
    np.testing.assert_allclose(kept.scan.points, scan(1).points, atol=1e-6)
    np.testing.assert_array_equal(kept.cloud, cloud)


def test_parameters_indicate_of_the_sensors(written: decode.Decoder, tmp_path: Path) -> None:
    """Odometry of the sample leaves the plane and has a laser; this one does neither."""
    reported = written.parameters()
    assert (reported["Grid/Sensor"], reported["Reg/Force3DoF"]) == ("0", "false")
    assert written.only("Info")["last_sign_added"] == 3
    lens = camera(distortion_model="plumb_bob", distortion=np.array([0.1, 0, 0, 0, 0]))
    flat = node(1, odom_from_base=np.eye(4), tracked_from_base=np.eye(4))
    given = {"Kp/MaxFeatures": "600", "Odd/Value": "a;b,c:d"}
    with (
        open_store(tmp_path / "map.db", create=True, parameters=given) as store,
        store.write_stage("track", "t"),
    ):
        store.add_node(flat, NodeData(images=(RgbdImage(lens, image().colour, None),)))
    decoder = decode.Decoder(tmp_path / "map.db")
    reported = decoder.parameters()
    assert (reported["Grid/Sensor"], reported["Reg/Force3DoF"]) == ("1", "true")
    assert reported["Rtabmap/ImagesAlreadyRectified"] == "false"
    assert reported["Kp/MaxFeatures"] == "600"
    assert reported["Odd/Value"] == "a b.c:d"
    decoder.close()
