"""Odometry faults: steps in which recorded odometry and scan matching contradict each other."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from mapmyworld.kernels.wheel_model import MOVES


def fault(recorded: NDArray[np.float64], moved: NDArray[np.float64]) -> str:
    """The kind of a step, x, y, yaw, `recorded` otherwise than it `moved` by scans; (3,) both."""
    along = recorded[0] * moved[0]
    if along < 0 and min(abs(recorded[0]), abs(moved[0])) > MOVES:
        return "has the wrong sign"
    if np.abs(recorded).max() < MOVES:
        return "stalls while the robot moves"
    if np.abs(recorded - moved).max() > np.abs(moved).max():
        return "jumps"
    return "disagrees with the scans"
