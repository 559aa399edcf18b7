"""How fast a laser sweeps is measured where its messages do not say: turning robots show it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from messages_in_memory import scan_at
from room_drive import START_NS, STEP_NS, drive, ranges_in_room
from scipy.spatial import cKDTree

from mapmyworld.api import Silent, build
from mapmyworld.config import Config
from mapmyworld.evaluation.trajectory_error import ate
from mapmyworld.geometry.planar import compose_planar, planar_to_matrix
from mapmyworld.memory_log import MemoryLog
from mapmyworld.odometry.beam_times import beam_times, turning_moments
from mapmyworld.sensing.motion import MotionRecorder
from mapmyworld.sensing.sweeps import scan_from_message
from mapmyworld.sensing.synchronise import scans_near
from mapmyworld.simulation import SimulationSettings, simulate
from mapmyworld.simulation.message_streams import ODOMETRY_TOPIC, TF_TOPIC
from mapmyworld.stages.first_pass import deskewed
from mapmyworld.stages.plan_log import plan_log
from mapmyworld.types import LaserScanMessage, Trajectory

AHEAD = planar_to_matrix(np.array([0.15, 0.0, 0.0]))
BACK = planar_to_matrix(np.array([-0.2, 0.1, np.pi]))
FLIPPED = AHEAD @ np.diag([1.0, -1.0, -1.0, 1.0])


def pose_at(seconds: np.ndarray) -> np.ndarray:
    """(N, 3) of a robot that swings to either side while it drives about a room."""
    x, y = 3.0 + 0.8 * np.sin(0.3 * seconds), 2.0 + 0.5 * np.cos(0.4 * seconds)
    return np.stack([x, y, 0.1 * seconds + 1.5 * np.sin(0.6 * seconds)], axis=-1)


def sweep(
    stamp_s: float, seconds: float, mount: np.ndarray, order: float, random: np.random.Generator
) -> LaserScanMessage:
    """A sweep whose beams follow each other by so many seconds a radian, from the stamp on."""
    angles = order * np.linspace(-np.pi / 2, np.pi / 2, 181)
    poses = pose_at(stamp_s + seconds * (order * angles + np.pi / 2))
    ways = np.stack([np.cos(angles), np.sin(angles)], axis=-1) @ mount[:2, :2].T
    lidar = compose_planar(poses, [*mount[:2, 3], 0.0])
    bearings = poses[:, 2] + np.arctan2(ways[:, 1], ways[:, 0])
    ranges = ranges_in_room(lidar[:, 0], lidar[:, 1], bearings) + random.normal(0.0, 0.01, 181)
    return scan_at(
        START_NS + round(stamp_s * 1e9), ranges, angle_min=angles[0],
        angle_increment=angles[1] - angles[0],
    )  # fmt: skip


@pytest.mark.parametrize("mount", [AHEAD, BACK, FLIPPED], ids=["ahead", "back", "flipped"])
@pytest.mark.parametrize("order", [1.0, -1.0])
@pytest.mark.parametrize("seconds", [0.0, 0.00212, 0.0318])
def test_turns_show_how_fast_a_laser_sweeps(
    seconds: float, order: float, mount: np.ndarray
) -> None:
    """Mirrors of 75 and 5 turns a second, and one that takes all beams at once."""
    random, recorder = np.random.default_rng(0), MotionRecorder()
    times = np.arange(0.0, 80.0, 0.1)
    for t, pose in zip(times.tolist(), pose_at(times), strict=True):
        recorder.add(START_NS + round(t * 1e9), planar_to_matrix(pose))
    motion = recorder.finish()
    moments = (turning_moments(motion) - START_NS) * 1e-9
    pairs = [(sweep(a, seconds, mount, order, random), sweep(b, seconds, mount, order, random))
             for a, b in moments.tolist()]  # fmt: skip
    found = beam_times(pairs, mount, motion, Config().registration)
    assert found.pairs >= 30
    assert found.sigma < 0.0005 + 0.03 * seconds
    assert abs(found.seconds - seconds) < 3.0 * found.sigma + 0.05 * seconds
    if seconds:
        first = float(moments[0, 0])
        truth = cKDTree(
            scan_from_message(sweep(first, 0.0, mount, order, random), mount, None).points
        )
        bent, put_right = (
            np.mean(truth.query(scan_from_message(pairs[0][0], mount, motion, s).points)[0])
            for s in (0.0, found.seconds)
        )
        assert put_right < max(0.2 * bent, 0.025)


def test_no_scans_show_no_beam_times() -> None:
    recorder = MotionRecorder()
    recorder.add(START_NS, np.eye(4))
    motion = recorder.finish()
    assert len(turning_moments(motion)) == 1
    assert np.isinf(beam_times([], AHEAD, motion, Config().registration).sigma)


def test_sweeps_stay_as_they_are_where_turns_do_not_show_how_fast() -> None:
    """All beams are taken at once; and a robot that stands."""
    moving = drive(80).entries
    times = [START_NS + k * STEP_NS for k in range(40)]
    standing = [(t, replace(m, stamp_ns=time), time) for time in times for t, m, _ in moving[1:3]]
    for entries, reason in (
        (moving, "ms per radian by"),
        ([moving[0], *standing], "no pair of scans"),
    ):
        log = MemoryLog(entries)
        plan = deskewed(log, plan_log(log, Config(), Silent()), Config(), Silent())
        assert plan.scan is not None
        assert plan.scan.seconds_a_radian == 0.0
        assert reason in plan.decisions[-1].reason
        assert not plan.decisions[-1].choice


def test_each_moment_has_the_scan_nearest_to_it_however_often_it_is_asked_for() -> None:
    log = MemoryLog(drive(20).entries)
    plan = plan_log(log, Config(), Silent())
    asked = START_NS + STEP_NS * np.array([5, 3, 5, 5, 8]) + np.array([0, 1, 0, -1, 2])
    found = scans_near(log, plan, asked, Config().sensing, lambda _: None)
    stamps = [START_NS + STEP_NS * k for k in (5, 3, 5, 5, 8)]
    assert [scan and scan.stamp_ns for scan in found] == stamps


@pytest.mark.parametrize("wheels", [True, False])
def test_a_laser_that_does_not_time_its_beams_maps_as_well(wheels: bool) -> None:
    """Of ten turns a second: turning by 0.6 rad/s stretches what is seen by a hundredth."""
    settings = SimulationSettings()
    laser = replace(settings.laser, beams=181, field_of_view=180.0, range_max=12.0)
    settings = replace(settings, laser=laser, camera=replace(settings.camera, enabled=False))
    recording = simulate("apartment", seed=3, laps=1, settings=settings)
    unused = () if wheels else (ODOMETRY_TOPIC, TF_TOPIC)
    timed = [m for m in recording.messages() if m[0] not in unused]
    log = MemoryLog([
        (topic, replace(m, time_increment=0.0) if isinstance(m, LaserScanMessage) else m, time)
        for topic, m, time in timed
    ])  # fmt: skip
    config, progress = Config(), Silent()
    plan = deskewed(log, plan_log(log, config, progress), config, progress)
    assert plan.scan is not None
    assert plan.scan.seconds_a_radian == pytest.approx(0.5 / (np.pi * laser.rate), rel=0.15)
    assert plan.decisions[-1].role == "beam times"
    errors = []
    for given in (log, MemoryLog(timed)):
        made = build(given).map
        poses = made.frame_poses()
        assert poses is not None
        path = Trajectory(made.tracked_frames().stamps_ns, poses)
        errors.append(ate(path, recording.truth.trajectory).translation.rmse)
    assert errors[0] < 1.2 * errors[1]  # 0.011 m where sweeps are left as they are
