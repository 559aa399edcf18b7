"""What a log shows of its odometry is known where it begins."""

from __future__ import annotations

import numpy as np
from laser_rooms import cast
from numpy.typing import NDArray

from mapmyworld.config import Config
from mapmyworld.geometry.planar import between_planar, compose_planar, planar_to_matrix
from mapmyworld.kernels.wheel_model import SYSTEMATIC
from mapmyworld.odometry.laser_odometry import LaserTracker
from mapmyworld.odometry.wheel_calibration import calibrated_wheels
from mapmyworld.parallel import batches
from mapmyworld.types import Frame

STEP = 0.25  # m, a scan
ENDS = 40.0  # m: where the bare part of the corridor ends


def building() -> NDArray[np.float64]:
    """Walls (N, 4): a bare corridor, and then alcoves to both sides, none like another."""
    random = np.random.default_rng(4)
    corners = [(-20.0, 1.0)]
    for x in np.arange(ENDS, 110.0, 3.0):
        width, depth = random.uniform(0.6, 1.8), random.uniform(0.3, 1.5)
        corners += [(x, 1.0), (x, 1.0 + depth), (x + width, 1.0 + depth), (x + width, 1.0)]
    above = np.array([*corners, (130.0, 1.0)])
    below = above * (1.0, -1.0) + (1.1, 0.0)
    walls = [np.column_stack([side[:-1], side[1:]]) for side in (above, below)]
    return np.concatenate(walls)


def drive(scale: float) -> list[Frame]:
    """Along it, with wheels that measure so much too little."""
    walls, x = building(), np.arange(0.0, 105.0, STEP)
    truth = np.stack([x, np.zeros(len(x)), 0.05 * np.sin(x / 4.0)], axis=-1)
    steps = between_planar(truth[:-1], truth[1:])
    steps[:, :2] *= 1.0 - scale
    steps += np.random.default_rng(1).normal(0.0, (0.01, 0.001, 0.001), steps.shape)
    poses = [np.zeros(3)]
    for step in steps:
        poses.append(compose_planar(poses[-1], step))
    odometry = planar_to_matrix(np.stack(poses))
    return [
        Frame(k * 200_000_000, odometry[k], cast(pose, walls, k)) for k, pose in enumerate(truth)
    ]


def length(frames: list[Frame], wheels: NDArray[np.float64] | None) -> float:
    """Metres of the bare corridor, tracked."""
    tracked = LaserTracker(Config(), wheels).track_all(frames)
    return float(np.hypot(*tracked[int(ENDS / STEP)].pose[:2]))


def test_a_bare_corridor_is_as_long_as_what_comes_after_it_shows() -> None:
    """Wheels that measure 6 % too little: nothing in the corridor itself tells."""
    frames = drive(0.06)
    wheels = calibrated_wheels(batches(frames, 16), Config())
    assert abs((1.0 + wheels[SYSTEMATIC][0]) * 0.94 - 1.0) < 0.01
    assert abs(length(frames, None) - ENDS) > 1.5
    assert abs(length(frames, wheels) - ENDS) < 0.4


def test_no_more_of_a_log_is_tracked_twice_than_shows_its_scale() -> None:
    """From the end of the drive back: the alcoves come first, and a part of them is enough."""
    frames = drive(0.06)
    rest = frames[int(ENDS / STEP) :]
    left = iter(rest)
    wheels = calibrated_wheels(batches(left, 16), Config())
    assert abs((1.0 + wheels[SYSTEMATIC][0]) * 0.94 - 1.0) < 0.02
    assert len(list(left)) > 0.3 * len(rest)
