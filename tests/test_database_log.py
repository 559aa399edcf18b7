"""A database as a log: the same sensors again, so that a map can be built anew."""

from __future__ import annotations

import dataclasses
from pathlib import Path

import numpy as np
import pytest
from database_samples import OPTICAL, fill, image, node, scan, tracked_frames
from foreign_database import add_nodes, insert, matrix, rtabmap_file, scan_info

from formats.database import open_store
from formats.database.log_messages import message_from_scan
from formats.database.log_source import open_database_log
from formats.logs import open_log
from mapmyworld.errors import LogError
from mapmyworld.geometry.planar import planar_to_matrix
from mapmyworld.sensing.sweeps import scan_from_message
from mapmyworld.types import (
    CameraInfoMessage,
    ImageMessage,
    LaserScanMessage,
    LogSource,
    Message,
    OdometryMessage,
    PoseMessage,
    Scan,
    TransformsMessage,
)


def decoded(log: LogSource, topic: str) -> list[Message]:
    return [raw.decode() for raw in log.messages([topic])]


@pytest.fixture
def ours(tmp_path: Path) -> LogSource:
    with open_store(tmp_path / "map.db", create=True) as store:
        fill(store)
    return open_log([tmp_path / "map.db"])


@pytest.mark.parametrize("recorded", [True, False])
def test_odometry_is_as_recorded_or_goes_on_from_the_nodes(tmp_path: Path, recorded: bool) -> None:
    frames = tracked_frames()
    with open_store(tmp_path / "map.db", create=True) as store:
        fill(store)
        if not recorded:
            frames = dataclasses.replace(frames, odom_from_base=None)
            store.set_tracked_frames(frames)
    messages = decoded(open_log([tmp_path / "map.db"]), "/odom")
    assert [m.stamp_ns for m in messages] == frames.stamps_ns.tolist()
    for i, message in enumerate(messages):
        assert isinstance(message, OdometryMessage)
        assert message.child_frame_id == "base_link"
        expected = node(int(frames.node_ids[i])).odom_from_base @ frames.node_from_frame[i]
        if frames.odom_from_base is not None:
            expected = frames.odom_from_base[i]
        np.testing.assert_allclose(message.pose, expected, atol=1e-12)


def test_every_tracked_scan_comes_back(ours: LogSource) -> None:
    messages = decoded(ours, "/scan")
    assert len(messages) == 6
    for frame, message in enumerate(messages):
        assert isinstance(message, LaserScanMessage)
        original = scan(frame // 2 + 1 + 10 * (frame % 2))
        again = scan_from_message(message, planar_to_matrix(original.origin), None)
        np.testing.assert_allclose(again.points, original.points, atol=3e-6)
        np.testing.assert_allclose(again.missing, original.missing, atol=1e-5)
        assert again.range_max == original.range_max


def test_images_mounts_and_truth(ours: LogSource) -> None:
    for i, message in enumerate(decoded(ours, "/camera/depth/image")):
        assert isinstance(message, ImageMessage)
        original = image(i + 1).depth
        assert original is not None
        assert message.is_depth
        np.testing.assert_allclose(message.pixels(), original.pixels(), atol=1e-6)
    info = decoded(ours, "/camera/rgb/camera_info")[0]
    assert isinstance(info, CameraInfoMessage)
    assert info.intrinsics[0, 0] == 60
    (mounts,) = decoded(ours, "/tf_static")
    assert isinstance(mounts, TransformsMessage)
    placed = {t.child: t.parent_from_child for t in mounts.transforms}
    np.testing.assert_allclose(placed["camera_optical"], OPTICAL, atol=1e-7)
    np.testing.assert_allclose(placed["laser"], planar_to_matrix(scan().origin))
    truths = decoded(ours, "/ground_truth")
    assert len(truths) == 2
    assert all(isinstance(truth, PoseMessage) for truth in truths)


def test_info_counts_what_messages_gives(ours: LogSource, data: Path) -> None:
    logs = [ours] + [open_log([data / f"rtabmap/{n}.db"]) for n in ("fr079_laser", "freiburg1_rpy")]
    for log in logs:
        counts: dict[str, int] = {}
        times = []
        for raw in log.messages():
            counts[raw.topic] = counts.get(raw.topic, 0) + 1
            times.append(raw.log_time_ns)
        assert {topic.topic: topic.count for topic in log.info().topics} == counts
        assert times == sorted(times)
        assert (log.info().start_ns, log.info().end_ns) == (times[0], times[-1])
        assert log.info().problems == ()


def test_motion_corrected_beams_are_not_moved_back() -> None:
    """Points off the lattice of beams keep their bearings to a thirty-second of a step."""
    rng = np.random.default_rng(1)
    step = np.radians(1.0)
    bearings = np.arange(-90, 90) * step + 0.3 * step * np.sin(np.arange(180) / 30)
    ranges = rng.uniform(1, 10, 180)
    points = np.column_stack([ranges * np.cos(bearings), ranges * np.sin(bearings)])
    origin = np.zeros(3)
    moved = Scan(points.astype(np.float32), origin, np.zeros(0, np.float32), 12.0, step)
    again = scan_from_message(message_from_scan(moved, 0, "laser"), np.eye(4), None)
    assert len(again.points) == 180
    gaps = np.linalg.norm(again.points - points, axis=1) / ranges
    assert gaps.max() < step / 32 + 1e-5


def test_a_scan_without_returns_or_beams() -> None:
    nothing = np.zeros((0, 2), np.float32)
    seen = np.array([-0.5, 0.0, 0.5], np.float32)
    message = message_from_scan(Scan(nothing, np.zeros(3), seen, 8.0, 0.5), 0, "laser")
    assert np.isposinf(message.ranges).tolist() == [True] * 3
    blind = Scan(nothing, np.zeros(3), np.zeros(0, np.float32), np.inf, 0.0)
    assert len(message_from_scan(blind, 0, "laser").ranges) == 0


def test_damaged_nodes_are_losses(tmp_path: Path) -> None:
    points = np.ones((1, 10, 2), np.float32)
    with rtabmap_file(tmp_path / "r.db") as sqlite:
        add_nodes(sqlite, 3)
        insert(sqlite, "Data", id=1, scan=matrix(points), scan_info=scan_info(1))
        insert(sqlite, "Data", id=2, scan=matrix(points, cols=99), scan_info=scan_info(1))
    log = open_database_log(tmp_path / "r.db")
    assert len(decoded(log, "/scan")) == 1
    assert len(log.info().problems) == 1
    assert "node 2's scan" in log.info().problems[0]
    assert len(decoded(log, "/odom")) == 3


def test_a_database_without_nodes_is_no_log(tmp_path: Path) -> None:
    with rtabmap_file(tmp_path / "r.db"):
        pass
    with pytest.raises(LogError, match="no nodes"):
        open_log([tmp_path / "r.db"])
