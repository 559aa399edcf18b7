"""Recordings: repeatable, in order, true in what they claim, readable by stock readers."""

from __future__ import annotations

import hashlib
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner

from formats.trajectory_files import read_trajectory
from formats.truth_files import read_loop_pairs
from mapmyworld.evaluation.relations_metric import poses_at
from mapmyworld.geometry.planar import (
    between_planar,
    matrix_to_planar,
    transform_points_planar,
    wrap_angle,
)
from mapmyworld.simulation import Recording, SimulationSettings, simulate
from mapmyworld.simulation.driver import drive_route
from mapmyworld.simulation.message_streams import ODOMETRY_TOPIC, SCAN_TOPIC
from mapmyworld.simulation.robot_settings import (
    BodySettings,
    CameraSettings,
    DriverSettings,
    ImuSettings,
    LaserSettings,
    OdometrySettings,
)
from mapmyworld.simulation.route import read_route
from mapmyworld.simulation.simulated_laser import Sweep, disturb_sweep
from mapmyworld.simulation.wheel_odometry import disturb_wheels, integrate_wheels, wheel_travel
from mapmyworld.types import LaserScanMessage, OdometryMessage, TransformsMessage

LASER_ONLY = SimulationSettings(
    camera=CameraSettings(enabled=False), imu=ImuSettings(enabled=False)
)


def of_topic(recording: Recording, topic: str) -> list:
    return [message for _, message, _ in recording.messages([topic])]


@pytest.fixture(scope="module")
def flat() -> Recording:
    return simulate("apartment", settings=LASER_ONLY)


def test_the_same_seed_gives_the_same_messages_and_another_seed_others() -> None:
    def digest(seed: int) -> str:
        found = hashlib.sha256()
        for topic, message, log_time_ns in simulate(
            "hall", seed=seed, route="2,0", settings=LASER_ONLY
        ).messages():
            found.update(f"{topic} {message.stamp_ns} {log_time_ns}".encode())
            if isinstance(message, LaserScanMessage):
                found.update(message.ranges.tobytes())
            if isinstance(message, OdometryMessage):
                found.update(message.pose.tobytes() + message.pose_covariance.tobytes())
        return found.hexdigest()

    assert digest(1) == digest(1)
    assert digest(1) != digest(2)


def test_messages_come_in_the_order_of_recording_and_after_they_were_measured() -> None:
    last: dict[str, int] = {}
    recorded = 0
    for topic, message, log_time_ns in simulate(
        "hall", route="3,0", settings=LASER_ONLY
    ).messages():
        assert log_time_ns >= recorded
        recorded = log_time_ns
        assert message.stamp_ns <= log_time_ns
        assert message.stamp_ns >= last.get(topic, 0)
        last[topic] = message.stamp_ns


def test_the_transforms_reach_every_sensor_from_odom() -> None:
    recording = simulate("hall", route="1,0", settings=LASER_ONLY)
    parents = {}
    for _, message, _ in recording.messages():
        if isinstance(message, TransformsMessage):
            parents |= {t.child: t.parent for t in message.transforms}
    assert parents["robot_footprint"] == "odom"
    assert parents["chassis"] == "robot_footprint"
    assert {parents[name] for name in ("hokuyo", "left_wheel", "right_wheel")} == {"chassis"}


def drift(recording: Recording) -> np.ndarray:
    """Error of the last odometry pose, x, y, yaw."""
    last = of_topic(recording, ODOMETRY_TOPIC)[-1]
    true = matrix_to_planar(poses_at(recording.truth.trajectory, np.array([last.stamp_ns]))[0])
    error = matrix_to_planar(last.pose) - true
    error[2] = wrap_angle(error[2])
    return error


@pytest.mark.parametrize("seed", [0, 1, 2])
def test_three_laps_of_the_apartment_drift_as_cheap_wheels_do(seed: int) -> None:
    error = drift(simulate("apartment", seed=seed, settings=LASER_ONLY))
    assert 1.0 < np.hypot(error[0], error[1]) < 3.0
    assert 10.0 < abs(np.degrees(error[2])) < 25.0


def test_the_odometrys_covariance_is_truthful() -> None:
    """Random errors and slips alone, over many drives: squared errors average to the variances."""
    settings, body = OdometrySettings(radius_error=0, imbalance=0, track_error=0), BodySettings()
    drive = drive_route(read_route("4,0 4,2"), DriverSettings())
    times = np.arange(0.0, drive.duration, 1.0 / settings.rate)
    travel = wheel_travel(drive, times, body)
    squares, claims = [], []
    for seed in range(60):
        reported = disturb_wheels(travel, times, settings, np.random.default_rng(seed))
        odometry = integrate_wheels(reported, times, settings, body)
        error = odometry.poses[-1] - drive.at(times[-1:])[0]
        squares.append(error**2)
        claims.append(np.diag(odometry.covariances[-1]))
    ratio = np.mean(squares, axis=0) / np.mean(claims, axis=0)
    # The mean of 60 squared normal values scatters by 18 %: four sigmas.
    assert (np.abs(ratio - 1.0) < 0.75).all()


def test_the_laser_agrees_with_the_true_grid(flat: Recording) -> None:
    """Returns, put into the world by the true pose of each beam, end in or beside walls."""
    grid = flat.truth.grid
    walls = np.argwhere(grid.trinary() == 100)[:, ::-1] + 0.5
    from scipy.spatial import cKDTree

    tree = cKDTree(walls * grid.resolution + grid.origin)
    mount = np.array([flat.truth.settings.laser.mount_x, 0.0, 0.0])
    (stream,) = (s for s in flat.streams if SCAN_TOPIC in s.topics)
    scans = [stream.messages(k)[0][1] for k in range(0, len(stream.schedule.times), 50)]
    for scan in scans:
        beams = np.flatnonzero(np.isfinite(scan.ranges))
        seconds = (scan.stamp_ns - flat.truth.start_ns) * 1e-9 + beams * scan.time_increment
        bearing = scan.angle_min + beams * scan.angle_increment
        local = np.column_stack([np.cos(bearing), np.sin(bearing)]) * scan.ranges[beams, None]
        points = transform_points_planar(
            flat.truth.drive.at(seconds), (local + mount[:2])[:, None]
        )[:, 0]
        assert (tree.query(points)[0] < 0.1).mean() > 0.97


def test_what_the_true_grid_calls_free_was_driven_through(flat: Recording) -> None:
    grid = flat.truth.grid
    cells = np.floor((flat.truth.drive.poses[::40, :2] - grid.origin) / grid.resolution).astype(int)
    assert (grid.trinary()[cells[:, 1], cells[:, 0]] == 0).all()


def test_true_loops_join_places_near_each_other_and_far_apart_in_time(flat: Recording) -> None:
    pairs = flat.truth.loop_pairs
    assert len(pairs.stamps_ns) > 50
    first, second = (
        matrix_to_planar(poses_at(flat.truth.trajectory, pairs.stamps_ns[:, k])) for k in (0, 1)
    )
    apart = between_planar(first, second)
    assert np.hypot(apart[:, 0], apart[:, 1]).max() < 1.05
    assert np.abs(apart - matrix_to_planar(pairs.first_from_second)).max() < 0.01
    assert (np.diff(pairs.stamps_ns, axis=1) >= 20 * 10**9).all()


def test_half_of_what_meets_glass_is_seen_behind_it() -> None:
    """Head-on, a share `glass_transmission` passes and all others come back from the pane."""
    settings = LaserSettings(glass_transmission=0.5, dropout=0.0, noise=0.0)
    count = 4000
    sweep = Sweep(np.full(count, 2.0), np.full(count, 5.0), np.ones(count))
    ranges = disturb_sweep(sweep, settings, np.random.default_rng(0))
    assert (ranges == 5.0).mean() == pytest.approx(0.5, abs=0.04)
    assert (ranges == 2.0).mean() == pytest.approx(0.5, abs=0.04)


def test_a_lasers_noise_is_as_large_as_its_setting_says() -> None:
    count = 4000
    sweep = Sweep(np.full(count, 2.0), np.full(count, 2.0), np.ones(count))
    ranges = disturb_sweep(sweep, LaserSettings(), np.random.default_rng(0))
    came_back = ranges[np.isfinite(ranges)]
    assert came_back.std() == pytest.approx(0.01, rel=0.1)
    assert 1.0 - len(came_back) / count == pytest.approx(0.002, abs=0.003)


def test_the_mesh_leaves_glass_out(flat: Recording) -> None:
    assert flat.truth.scene.glass.any()
    assert len(flat.truth.scene.mesh().triangles) == (~flat.truth.scene.glass).sum()


@pytest.mark.parametrize("suffix", [".mcap", ".bag"])
def test_the_command_writes_the_same_bytes_twice_and_stock_readers_read_them(
    tmp_path: Path, suffix: str
) -> None:
    from rosbags.highlevel import AnyReader
    from rosbags.typesys import Stores, get_typestore

    from cli.main import group

    logs = [tmp_path / f"{name}{suffix}" for name in "ab"]
    for log in logs:
        arguments = ["simulate", "hall", "-o", str(log), "--route", "1.5,0", "--no-camera", "-q"]
        result = CliRunner().invoke(group, arguments)
        assert result.exit_code == 0, result.output
    assert logs[0].read_bytes() == logs[1].read_bytes()
    with AnyReader([logs[0]], default_typestore=get_typestore(Stores.ROS2_HUMBLE)) as reader:
        topics = {c.topic: c.msgcount for c in reader.connections}
    assert topics[SCAN_TOPIC] > 20
    assert topics["/robot_description"] == topics["/tf_static"] == 1
    truth = tmp_path / f"a{suffix}.truth"
    assert len(read_trajectory(truth / "trajectory.tum").stamps_ns) > 100
    assert read_loop_pairs(truth / "loop_pairs.csv").shape[1] == 2
    assert {p.name for p in truth.iterdir()} == {
        "trajectory.tum", "grid.pgm", "grid.yaml", "mesh.ply", "loop_pairs.csv", "calibration.json",
    }  # fmt: skip


def test_the_command_refuses_what_it_does_not_know(tmp_path: Path) -> None:
    from cli.main import group
    from mapmyworld.errors import ConfigError, WorldError

    with pytest.raises(ConfigError, match=r"laser\.range_max"):
        CliRunner().invoke(
            group,
            ["simulate", "hall", "-o", str(tmp_path / "a.mcap"), "--set", "laser.rangemax=3"],
            catch_exceptions=False,
        )
    with pytest.raises(WorldError, match="apartment"):
        CliRunner().invoke(
            group, ["simulate", "moon", "-o", str(tmp_path / "a.mcap")], catch_exceptions=False
        )
    assert not list(tmp_path.iterdir())
