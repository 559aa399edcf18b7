"""How far recorded odometry can be believed, learnt from what the scans say."""

from __future__ import annotations

from collections import Counter

import numpy as np
from numpy.typing import NDArray

from mapmyworld.config import OdometryConfig
from mapmyworld.geometry import between_planar
from mapmyworld.kernels.scan_alignment import invert3
from mapmyworld.registration.scan_matching import Match

_FAINT = 1e-3 * np.eye(3)  # information that keeps an open direction finite
_MEMORY = 0.95  # weight of the past in the running mean of squared surprises
_STILL = 0.01  # m and rad within which a frame's motion counts as none
_JUMP = 0.3  # rad or m by which odometry exceeds the match in a catch-up step


class OdometryTrust:
    """Scales the odometry's covariance with the disagreement measured so far."""

    def __init__(self, config: OdometryConfig) -> None:
        self._config = config
        self._scale = 1.0
        self._faults: Counter[str] = Counter()
        self._steps = 0

    def covariance(self, step: NDArray[np.float64], recorded: bool) -> NDArray[np.float64]:
        """(3, 3) of a motion; wide where nothing was recorded and inertia is all there is."""
        distance, angle = float(np.hypot(step[0], step[1])), abs(float(step[2]))
        share, floor = self._config.share_sigma, self._config.floor_sigma
        if not recorded:
            share, floor = 1.0, 0.1
        along = floor + share * distance + 0.2 * share * angle
        turn = 0.5 * floor + share * angle + 0.3 * share * distance
        scale = self._scale if recorded else 1.0
        return np.diag([along**2, along**2, turn**2]) * scale

    def surprise(
        self, predicted: NDArray[np.float64], match: Match, covariance: NDArray[np.float64]
    ) -> float:
        """Squared sigmas between prediction and match, the prior's pull on the match undone."""
        error = between_planar(predicted, match.pose)
        own = invert3(match.information + _FAINT)
        error = error + own @ (invert3(covariance) @ error)
        return float(error @ invert3(covariance + own) @ error)

    def learn(
        self, recorded: NDArray[np.float64], moved: NDArray[np.float64], surprise: float
    ) -> None:
        """Takes note of one more step of which odometry and match are known."""
        self._steps += 1
        squared = min(surprise / 3.0 * self._scale, 400.0)
        moving = max(np.abs(moved).max(), np.abs(recorded).max()) > _STILL
        if moving:
            self._scale = max(_MEMORY * self._scale + (1.0 - _MEMORY) * squared, 1.0)
        if surprise > self._config.contradiction**2:
            self._faults[_fault(recorded, moved)] += 1

    def notes(self) -> tuple[str, ...]:
        """Kinds of faults and how often they came."""
        return tuple(
            f"odometry {kind} at {count} of {self._steps} scans"
            for kind, count in self._faults.most_common()
        )


def _fault(recorded: NDArray[np.float64], moved: NDArray[np.float64]) -> str:
    along = recorded[0] * moved[0]
    if along < 0 and min(abs(recorded[0]), abs(moved[0])) > _STILL:
        return "runs the wrong way"
    if np.abs(recorded).max() < _STILL:
        return "stalls while the robot moves"
    if np.abs(recorded - moved).max() > _JUMP:
        return "jumps"
    return "disagrees with the scans"
