"""Ranges that are rounded to 5 cm make steps of every wall: they must not turn the robot."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from laser_rooms import cast

from mapmyworld.config import Config
from mapmyworld.kernels.scan_preparation import range_noise
from mapmyworld.odometry.laser_odometry import LaserTracker
from mapmyworld.registration.scan_matching import prepare_scan
from mapmyworld.types import Frame, Scan

STEP = 0.05  # m
CONFIG = Config().registration
CORRIDOR = np.array([[-20.0, 1.3, 200.0, 1.3], [-20.0, -1.3, 200.0, -1.3]])


def rounded(scan: Scan, step: float) -> Scan:
    """The scan with its ranges to the step."""
    ranges = np.linalg.norm(scan.points, axis=1, keepdims=True)
    return replace(scan, points=scan.points * np.float32(np.round(ranges / step) * step / ranges))


def sees(x: float, seed: int, step: float = STEP) -> Scan:
    scan = cast(np.array([x, 0.0, 0.0]), CORRIDOR, seed)
    return rounded(scan, step) if step else scan


def test_a_corridor_is_straight() -> None:
    """Of the points of a step the one behind the leap was matched: outwards to the right, inwards
    to the left, which turned three of three drives of 100 m by half a degree to the right.
    """
    odometry = np.tile(np.eye(4), (200, 1, 1))
    odometry[:, 0, 3] = 0.5 * np.arange(200)
    turned = []
    for seed in (1000, 2000, 3000):
        frames = [Frame(k * 100_000_000, odometry[k], sees(0.5 * k, seed + k)) for k in range(200)]
        turned.append(LaserTracker(Config()).track_all(frames)[-1].pose[2])
    assert abs(np.degrees(np.mean(turned))) < 0.15


@pytest.mark.parametrize("step", [0.0, 0.01, STEP])
def test_the_noise_of_ranges_is_that_of_rounding_at_least(step: float) -> None:
    """Claimed before: 1 mm of 5 cm, for along a wall neighbours are rounded alike."""
    measured = []
    for seed in range(10):
        x, y = sees(0.37 * seed, seed, step).points.T.astype(np.float64)
        measured.append(range_noise(x, y, np.zeros(2)))
    assert np.median(measured) == pytest.approx(np.hypot(0.01, step / np.sqrt(12.0)), rel=0.25)


def test_normals_of_a_rounded_wall_are_as_certain_as_they_are_right() -> None:
    """Twice as uncertain as stated, and along a corridor they are all that a match knows."""
    rows = np.concatenate([prepare_scan(sees(0.37 * k, k), CONFIG).rows for k in range(10)])
    rows = rows[np.hypot(rows[:, 2], rows[:, 3]) > 0.5].astype(np.float64)
    error = np.arctan2(rows[:, 2], np.abs(rows[:, 3]))
    assert 0.2 < np.sum(error**2) / np.sum(rows[:, 5]) < 1.0
