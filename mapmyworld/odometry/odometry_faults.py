"""Odometry faults: steps in which recorded odometry and scan matching contradict each other."""

from __future__ import annotations

from collections import Counter

import numpy as np
from numpy.typing import NDArray

from mapmyworld.kernels.wheel_model import MOVES


class OdometryFaults:
    """Counts the steps in which odometry and scans contradict each other, by kind."""

    def __init__(self) -> None:
        self._faults: Counter[str] = Counter()
        self.steps = 0
        """Steps of which odometry and match are known."""

    def add(self, recorded: NDArray[np.float64], moved: NDArray[np.float64]) -> None:
        """One more step, x, y, yaw, `recorded` otherwise than it `moved` by scans; (3,) both."""
        self._faults[_fault(recorded, moved)] += 1

    def notes(self) -> tuple[str, ...]:
        """Kinds of faults and how often they came."""
        return tuple(
            f"odometry {kind} at {count} of {self.steps} scans"
            for kind, count in self._faults.most_common()
        )


def _fault(recorded: NDArray[np.float64], moved: NDArray[np.float64]) -> str:
    along = recorded[0] * moved[0]
    if along < 0 and min(abs(recorded[0]), abs(moved[0])) > MOVES:
        return "has the wrong sign"
    if np.abs(recorded).max() < MOVES:
        return "stalls while the robot moves"
    if np.abs(recorded - moved).max() > np.abs(moved).max():
        return "jumps"
    return "disagrees with the scans"
