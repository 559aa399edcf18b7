"""Ranges that are rounded to 5 cm make steps of every wall: they must not turn the robot."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from laser_rooms import cast

from mapmyworld.config import Config
from mapmyworld.odometry.laser_odometry import LaserTracker
from mapmyworld.types import Frame, Scan

STEP = 0.05  # m
CORRIDOR = np.array([[-20.0, 1.3, 200.0, 1.3], [-20.0, -1.3, 200.0, -1.3]])


def rounded(scan: Scan) -> Scan:
    """The scan with its ranges to the step."""
    ranges = np.linalg.norm(scan.points, axis=1, keepdims=True)
    return replace(scan, points=scan.points * np.float32(np.round(ranges / STEP) * STEP / ranges))


def sees(x: float, seed: int) -> Scan:
    return rounded(cast(np.array([x, 0.0, 0.0]), CORRIDOR, seed))


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
