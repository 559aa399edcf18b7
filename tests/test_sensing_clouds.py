"""A 3D lidar where no planar laser is: a slice of its points is the scan."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner
from messages_in_memory import MemoryLog
from room_drive import ROOM, Drive, drive

import mapmyworld
from cli.main import group
from formats.cloud_files import read_cloud
from mapmyworld.config import SensingConfig
from mapmyworld.errors import LogError
from mapmyworld.geometry.planar import between_planar, matrix_to_planar
from mapmyworld.sensing import make_plan, survey_log
from mapmyworld.sensing.cloud_scans import points_of_cloud, scan_of_points, thinned
from mapmyworld.types import LaserScanMessage, Message, Node, NodeData, PointCloudMessage, Poses

HEIGHTS = (0.5, 1.0, 1.9)  # m, at which the lidar's rings meet a wall
SETTINGS = SensingConfig()
NOTHING = np.zeros((0, 3), np.float32)


def cloud_of(scan: Message) -> Message:
    """What a lidar of several rings sees where a laser sees one: walls, floor and ceiling."""
    assert isinstance(scan, LaserScanMessage)
    angles = scan.angle_min + scan.angle_increment * np.arange(len(scan.ranges))
    wall = scan.ranges[:, None] * np.stack([np.cos(angles), np.sin(angles)], axis=-1)
    rings = [np.column_stack([wall, np.full(len(wall), height)]) for height in HEIGHTS]
    floor = np.column_stack([0.4 * wall, np.full(len(wall), 0.02)])
    ceiling = np.column_stack([0.6 * wall, np.full(len(wall), 2.6)])
    body = np.array([[0.1, 0.05, 0.3], [-0.2, 0.1, 0.4]])
    points = np.concatenate([floor, *rings, ceiling, body]).astype(np.float32)
    finite = np.isfinite(points).all(axis=1)  # as readers of clouds give them
    return PointCloudMessage(scan.stamp_ns, scan.frame_id, points[finite], None)


@pytest.fixture(scope="module")
def clouds() -> Drive:
    return drive().changed("/scan", cloud_of)


def test_the_slice_is_what_a_laser_sees() -> None:
    """Floor, ceiling and the robot's own body are left out; a bearing keeps its nearest point."""
    sweep = next(m for _, m, _ in drive().entries if isinstance(m, LaserScanMessage))
    mount = np.eye(4)
    mount[:3, 3] = 0.15, 0.0, 0.0
    message = cloud_of(sweep)
    assert isinstance(message, PointCloudMessage)
    scan = scan_of_points(points_of_cloud(message, mount, SETTINGS), mount, SETTINGS)
    away = scan.points - scan.origin[:2]
    bearings = np.arctan2(away[:, 1], away[:, 0])
    angles = sweep.angle_min + sweep.angle_increment * np.arange(len(sweep.ranges))
    seen = sweep.ranges[np.abs(angles[None] - bearings[:, None]).argmin(axis=1)]
    np.testing.assert_allclose(np.hypot(*away.T), seen, atol=1e-5)
    assert len(scan.points) == np.isfinite(sweep.ranges).sum()
    assert (np.diff(np.mod(bearings, 2 * np.pi)) > 0).all()
    assert len(scan.missing) == 0


def test_an_empty_cloud_is_refused() -> None:
    with pytest.raises(LogError, match="without points"):
        points_of_cloud(PointCloudMessage(0, "", NOTHING, None), np.eye(4), SETTINGS)


def test_a_map_of_clouds_is_that_of_the_scans(clouds: Drive) -> None:
    made = [mapmyworld.build(MemoryLog(d.entries)).map for d in (drive(), clouds)]
    for found in made:
        poses = found.frame_poses()
        assert poses is not None
        apart = between_planar(
            between_planar(drive().truth[0], drive().truth), matrix_to_planar(poses)
        )
        assert np.hypot(*apart[:, :2].T).max() < 0.03
    walls = [(g.probabilities() > 0.65).sum() for m in made if (g := m.grid()) is not None]
    assert walls[1] == pytest.approx(walls[0], rel=0.2)


def test_the_points_become_the_cloud(clouds: Drive, tmp_path: Path) -> None:
    """Every wall at every height, the floor and the ceiling, where the room is."""
    clouds.write(tmp_path / "log.mcap")
    run = CliRunner().invoke(
        group, ["build", str(tmp_path / "log.mcap"), "-o", str(tmp_path / "map.db"), "-q"]
    )
    assert run.exit_code == 3, run.output  # the points serve as flat scans
    points = read_cloud(tmp_path / "map.ply").points
    for height in (0.02, *HEIGHTS, 2.6):
        assert (np.abs(points[:, 2] - height) < 0.02).sum() > 200
    walls = points[np.abs(points[:, 2] - 1.0) < 0.02]
    assert np.ptp(walls[:, :2], axis=0).max() < np.hypot(*ROOM)


def test_a_thinned_cloud_keeps_one_point_a_cube() -> None:
    cloud = np.random.default_rng(0).uniform(-1, 1, (500, 3)).astype(np.float32)
    kept = thinned(cloud, 0.5)
    cubes = np.floor(kept / 0.5)
    assert (
        len(np.unique(cubes, axis=0)) == len(kept) == len(np.unique(np.floor(cloud / 0.5), axis=0))
    )
    assert (kept[:, None] == cloud[None]).all(axis=2).any(axis=1).all()


def test_the_plan_says_that_clouds_serve_as_scans(clouds: Drive, tmp_path: Path) -> None:
    clouds.write(tmp_path / "log.mcap")
    reported = CliRunner().invoke(group, ["inspect", "log", str(tmp_path / "log.mcap")])
    assert "80 clouds at 10.0 Hz" in reported.output
    assert "3D points serve as flat scans" in reported.output


def test_a_laser_comes_first_and_a_cameras_points_are_no_scan(clouds: Drive) -> None:
    both = [*drive().entries, *(("/points", m, t) for n, m, t in clouds.entries if n == "/scan")]
    plan = make_plan(survey_log(MemoryLog(both)), SETTINGS)
    assert plan.scan is not None
    assert plan.scan.topic == "/scan"
    chosen = SensingConfig(scan_topic="/points")
    assert make_plan(survey_log(MemoryLog(both)), chosen).scan.topic == "/points"  # type: ignore[union-attr]
    narrow = clouds.changed("/scan", ahead_only)
    with pytest.raises(LogError, match="too narrow"):
        make_plan(survey_log(MemoryLog(narrow.entries)), SETTINGS)


def ahead_only(message: Message) -> Message:
    """The third of a cloud that a depth camera would see."""
    assert isinstance(message, PointCloudMessage)
    points = message.points
    ahead = np.abs(np.arctan2(points[:, 1], points[:, 0])) < 0.5
    return PointCloudMessage(message.stamp_ns, message.frame_id, points[ahead], None)


def test_voxels_of_a_lidars_cloud_are_not_finer_than_its_points_allow() -> None:
    """With 2 cm each thinned point takes a voxel of its own, and an hour's take all memory."""
    rng = np.random.default_rng(0)
    store = mapmyworld.MemoryMap()
    with store.write_stage("track", ""):
        for k in range(1, 31):  # a wall seen from thirty places, each time by other points
            seen = thinned(rng.uniform(0, 10, (40_000, 3)) * [1, 0, 0.3], 0.1).astype(np.float32)
            store.add_node(Node(k, 0, k, np.eye(4), np.eye(4)), NodeData(cloud=seen))
        store.set_poses(Poses(np.arange(1, 31), np.tile(np.eye(4), (30, 1, 1))))
    made = mapmyworld.cloud(store)
    assert len(made.points) <= 200 * 60
    coarse = mapmyworld.cloud(store, config=mapmyworld.configured(visual__cloud_voxel=0.2))
    assert len(coarse.points) <= 50 * 15
