"""Sweeps of a log without odometry are deskewed by the laser's own motion."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from mapmyworld.api import build
from mapmyworld.evaluation.nees import map_nees
from mapmyworld.evaluation.relations_metric import poses_at
from mapmyworld.evaluation.trajectory_error import ate
from mapmyworld.geometry.planar import between_planar, matrix_to_planar
from mapmyworld.memory_log import MemoryLog
from mapmyworld.simulation import SimulationSettings, simulate
from mapmyworld.simulation.message_streams import ODOMETRY_TOPIC, TF_TOPIC
from mapmyworld.types import Trajectory


def test_a_path_by_laser_alone_lies_where_the_robot_was_at_the_stamps() -> None:
    """Not half a sweep (25 ms) later, which the covariances would know nothing of."""
    settings = SimulationSettings()
    laser = replace(settings.laser, beams=181, field_of_view=180.0, range_max=12.0)
    settings = replace(settings, laser=laser, camera=replace(settings.camera, enabled=False))
    recording = simulate("apartment", seed=3, laps=1, settings=settings)
    odometry = (ODOMETRY_TOPIC, TF_TOPIC)
    made = build(MemoryLog([m for m in recording.messages() if m[0] not in odometry])).map
    truth, poses, nodes = recording.truth.trajectory, made.frame_poses(), made.nodes()
    assert poses is not None
    stamps = made.tracked_frames().stamps_ns
    assert ate(Trajectory(stamps, poses), truth).translation.rmse < 0.006
    a, b = (matrix_to_planar(poses_at(truth, stamps + dt)) for dt in (-20_000_000, 20_000_000))
    rate = between_planar(a, b)[:, 2] / 0.04
    error = between_planar(matrix_to_planar(poses_at(truth, stamps)), matrix_to_planar(poses))[:, 2]
    (lag, _), *_ = np.linalg.lstsq(np.stack([rate, np.ones_like(rate)], 1), error, rcond=None)
    assert abs(lag) < 0.005
    found = map_nees(tuple(nodes), made.poses(), truth)
    assert found is not None
    assert found < 3.0
