"""Maps of whole builds, decoded by RTAB-Map's description and held against the log itself."""

from __future__ import annotations

import bz2
from collections.abc import Iterator
from itertools import pairwise
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
import rtabmap_decoder as decode
from click.testing import CliRunner
from mcap_ros2.reader import read_ros2_messages

from cli.main import group

pytestmark = pytest.mark.slow
SAMPLE = Path(__file__).parent.parent / "sample_logs" / "apartment.mcap"


def build(log: Path, path: Path) -> decode.Decoder:
    words = ["build", str(log), "-o", str(path), "-q"]
    result = CliRunner().invoke(group, words)
    assert result.exit_code == 0, result.output
    return decode.Decoder(path)


def seconds(stamp: Any) -> float:
    return float(stamp.sec) + float(stamp.nanosec) * 1e-9


@pytest.fixture(scope="module")
def messages() -> dict[str, list[Any]]:
    found: dict[str, list[Any]] = {}
    for message in read_ros2_messages(str(SAMPLE)):
        found.setdefault(message.channel.topic, []).append(message.ros_msg)
    return found


@pytest.fixture(scope="module")
def sample(tmp_path_factory: pytest.TempPathFactory) -> Iterator[decode.Decoder]:
    decoder = build(SAMPLE, tmp_path_factory.mktemp("sample") / "map.db")
    yield decoder
    decoder.close()


def path_of(folder: decode.Decoder, name: str) -> Path:
    (_, _, file) = folder.sqlite.execute("PRAGMA database_list").fetchone()
    return Path(file).with_name(name)


def test_poses_of_nodes_are_the_odometry(
    sample: decode.Decoder, messages: dict[str, list[Any]]
) -> None:
    stamps = [seconds(m.header.stamp) for m in messages["/odom"]]
    places = [(m.pose.pose.position.x, m.pose.pose.position.y) for m in messages["/odom"]]
    nodes = sample.rows("Node", "id")
    at = np.array([row["stamp"] for row in nodes])
    poses = np.array([decode.transform(row["pose"]) for row in nodes])
    recorded = np.stack([np.interp(at, stamps, axis) for axis in np.transpose(places)], axis=1)
    apart = poses[:, :2, 3] - recorded
    # A map may begin where the robot stands; it turns and shifts odometry by one pose at most.
    assert np.abs(apart - apart[0]).max() < 2e-3
    speeds = [np.frombuffer(row["velocity"], "<f4") for row in nodes[1:]]
    steps = np.linalg.norm(np.diff(poses[:, :3, 3], axis=0), axis=1) / np.diff(at)
    np.testing.assert_allclose([np.linalg.norm(v[:3]) for v in speeds], steps, rtol=1e-3, atol=1e-4)


def test_images_depth_and_cameras_are_the_logs(
    sample: decode.Decoder, messages: dict[str, list[Any]]
) -> None:
    pictures = {
        bytes(m.data): seconds(m.header.stamp)
        for m in messages["/camera_ir/rgb/image_raw/compressed"]
    }
    depths = {
        seconds(m.header.stamp): cv2.imdecode(
            np.frombuffer(bytes(m.data)[12:], np.uint8), cv2.IMREAD_UNCHANGED
        )
        for m in messages["/camera_ir/depth/image_raw/compressedDepth"]
    }
    info = messages["/camera_ir/rgb/camera_info"][0]
    stamps = {row["id"]: row["stamp"] for row in sample.rows("Node")}
    seen = [row for row in sample.rows("Data") if row["image"] is not None]
    assert len(seen) > 60
    for row in seen:
        taken = pictures[row["image"]]  # byte for byte one of the log's
        assert abs(taken - stamps[row["id"]]) < 0.2
        (camera,) = decode.calibrations(row["calibration"])
        assert camera["size"] == (info.width, info.height)
        np.testing.assert_array_equal(camera["K"], info.k)
    for row in seen[::10]:
        taken = depths[pictures[row["image"]]]
        np.testing.assert_allclose(decode.depth_metres(row["depth"]), taken * 1e-3, atol=1e-9)


def test_scans_are_the_logs(sample: decode.Decoder, messages: dict[str, list[Any]]) -> None:
    """While the robot stands at first a scan is as recorded; later, moved with the robot."""
    scans = {seconds(m.header.stamp): m for m in messages["/graph_slam_bot/laser/scan"]}
    stamps = np.array(sorted(scans))
    parents = {t.child_frame_id: t for t in messages["/tf_static"][0].transforms}
    frame, forward = next(iter(scans.values())).header.frame_id, 0.0
    while frame in parents:  # the sample's laser looks where the robot does
        forward += parents[frame].transform.translation.x
        frame = parents[frame].header.frame_id
    for node, row in zip(sample.rows("Node"), sample.rows("Data"), strict=True):
        reported = decode.scan_info(row["scan_info"])
        assert reported["range_max"] == pytest.approx(30.0)
        assert reported["mount"][0, 3] == pytest.approx(forward, abs=1e-6)
        points = decode.matrix(row["scan"])[0]
        scan = scans[float(stamps[np.abs(stamps - node["stamp"]).argmin()])]
        ranges = np.asarray(scan.ranges)
        beams = np.isfinite(ranges) & (ranges > scan.range_min) & (ranges < scan.range_max)
        assert len(points) == np.count_nonzero(beams)
        apart = np.abs(np.linalg.norm(points, axis=1) - ranges[beams])
        assert np.median(apart) < (1e-5 if node["id"] == 1 else 0.1)


def test_features_project_to_their_pixels(sample: decode.Decoder) -> None:
    words = {row["id"]: row["descriptor"] for row in sample.rows("Word")}
    cameras = {
        row["id"]: decode.calibrations(row["calibration"])[0]
        for row in sample.rows("Data")
        if row["calibration"] is not None
    }
    features = [row for row in sample.rows("Feature") if row["depth_x"] is not None]
    assert len(features) > 5000
    for row in features[::7]:
        camera = cameras[row["node_id"]]
        point = [row["depth_x"], row["depth_y"], row["depth_z"], 1.0]
        seen = camera["K"].reshape(3, 3) @ (np.linalg.inv(camera["L"]) @ point)[:3]
        np.testing.assert_allclose(seen[:2] / seen[2], [row["pos_x"], row["pos_y"]], atol=0.02)
        assert len(row["descriptor"]) == len(words[row["word_id"]]) == row["descriptor_size"]


def test_poses_and_grid_are_those_of_the_files_beside(sample: decode.Decoder) -> None:
    trajectory = np.loadtxt(path_of(sample, "map.tum"))
    optimised = sample.optimised()
    nodes = sample.rows("Node")
    assert sorted(optimised) == [row["id"] for row in nodes]
    for row in nodes:
        line = trajectory[np.abs(trajectory[:, 0] - row["stamp"]).argmin()]
        np.testing.assert_allclose(optimised[row["id"]][:3, 3], line[1:4], atol=2e-6)
    admin = sample.only("Admin")
    cells = decode.matrix(admin["opt_map"])[::-1, :, 0]
    grey = cv2.imread(str(path_of(sample, "map.pgm")), cv2.IMREAD_UNCHANGED)
    np.testing.assert_array_equal(cells, np.select([grey == 0, grey >= 254], [100, 0], -1))


def test_links_hold_the_graph_together(sample: decode.Decoder) -> None:
    check_links(sample)
    kinds = {row["type"] for row in sample.rows("Link")}
    assert {0, 1} <= kinds


def check_links(decoder: decode.Decoder) -> None:
    """Both directions, one chain of neighbours, and near what the optimised poses say."""
    optimised = decoder.optimised()
    links = {(row["from_id"], row["to_id"], row["type"]): row for row in decoder.rows("Link")}
    ids = sorted(optimised)
    assert all((a, b, 0) in links for a, b in pairwise(ids))
    for (a, b, kind), row in links.items():
        forth, back = (decode.transform(r["transform"]) for r in (row, links[b, a, kind]))
        np.testing.assert_allclose(forth @ back, np.eye(4), atol=1e-5)
        assert (np.diag(decode.information(row["information_matrix"])) > 0).all()
        solved = np.linalg.inv(optimised[a]) @ optimised[b]
        assert np.linalg.norm((solved - forth)[:2, 3]) < 0.1


@pytest.mark.real_log
def test_a_laser_log(data: Path, tmp_path: Path) -> None:
    """CSAIL, whose ranges are in its text file: node by node the scan of that line."""
    with bz2.open(data / "laser" / "mit-csail.clf.bz2", "rt") as lines:
        scans = [line.split() for line in lines if line.startswith("FLASER ")]
    lengths = {
        float(words[-3]): np.array([float(w) for w in words[2 : 2 + int(words[1])]])
        for words in scans
    }
    decoder = build(data / "laser" / "mit-csail.clf.bz2", tmp_path / "map.db")
    stamps = np.array(sorted(lengths))
    exact = 0
    for node, row in zip(decoder.rows("Node"), decoder.rows("Data"), strict=True):
        points = decode.matrix(row["scan"])[0]
        ranges = lengths[float(stamps[np.abs(stamps - node["stamp"]).argmin()])]
        reported = decode.scan_info(row["scan_info"])
        recorded = ranges[ranges < reported["range_max"]]
        found = np.linalg.norm(points, axis=1)
        exact += len(found) == len(recorded) and bool(np.abs(found - recorded).max() < 0.1)
    assert exact > 0.95 * len(decoder.rows("Node"))
    check_links(decoder)
    poses, trajectory = decoder.optimised(), np.loadtxt(tmp_path / "map.tum")
    assert len(poses) == len(decoder.rows("Node")) <= len(trajectory)
    decoder.close()
