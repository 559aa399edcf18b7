"""How far a robot may get while nothing observes it, learnt from how it moves while scans do.

Constant velocity, and white acceleration: after t seconds the variances are q t^3 / 3 (Bar-Shalom,
Li and Kirubarajan, "Estimation with applications to tracking and navigation", 2001, section 6.2);
or 2 v^2 t^2, where that is less: another velocity of those that the robot has.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from mapmyworld.geometry import Array
from mapmyworld.geometry.planar import between_planar, planar_exp, planar_log
from mapmyworld.kernels.wheel_model import MEMORY, MOVES

GOES_ON = 1.0
"""Seconds for which a motion is expected to go on as it was, and the next is compared with it."""
FARTHEST = 1e3
"""Metres: farther than maps reach."""
_OPEN = np.square([FARTHEST, FARTHEST, np.pi])  # m^2, m^2, rad^2; any heading
_SUBMAP = 5.0  # m about that a submap shows around a robot


class UnobservedMotion:
    """The last second's motion, and how fast and how steadily the robot has moved so far."""

    def __init__(self) -> None:
        self._acceleration = np.ones(3)  # m^2/s^3, m^2/s^3, rad^2/s^3, before anything was seen
        self._square_velocity = np.ones(3)  # m^2/s^2, m^2/s^2, rad^2/s^2
        self._since, self._pose = 0.0, np.zeros(3)
        self._moved, self._took = np.zeros(3), 0.0

    def restart(self, seconds: float, pose: Array) -> None:
        """Begins anew at a time and a pose (3,), whose velocity is unknown."""
        self._since, self._pose = seconds, pose.copy()
        self._took = 0.0

    def add(self, seconds: float, pose: Array) -> None:
        """The pose (3,) that scans report at a time."""
        took = seconds - self._since
        if took < GOES_ON:
            return
        moved = between_planar(self._pose, pose)
        if self._took and max(np.hypot(*moved[:2]), abs(moved[2])) > MOVES:
            error = between_planar(self.step(took), moved)
            _learn(self._acceleration, 3.0 * error**2 / took**3)
            _learn(self._square_velocity, (moved / took) ** 2)
        self._moved, self._took = moved, took
        self._since, self._pose = seconds, pose.copy()

    def step(self, seconds: float) -> Array:
        """The motion (3,) expected of so many seconds: it goes on as it did, and then stays."""
        if not self._took or self.may_have_left(seconds):
            return np.zeros(3)
        return planar_exp(planar_log(self._moved) * (seconds / self._took))

    def variances(self, seconds: ArrayLike) -> Array:
        """(..., 3) m^2, m^2, rad^2, of how far off that may be after so long (...)."""
        seconds = np.asarray(seconds, np.float64)[..., None]
        smooth = self._acceleration * seconds**3 / 3.0
        varied = 2.0 * self._square_velocity * seconds**2
        return np.minimum(np.minimum(smooth, varied), _OPEN)

    def may_have_left(self, seconds: ArrayLike) -> NDArray[np.bool_]:
        """(...) whether after so long (...) the robot may be beyond what a submap shows."""
        return np.asarray(3.0 * np.sqrt(self.variances(seconds)[..., 0]) > _SUBMAP)


def _learn(mean: Array, sample: Array) -> None:
    """Lets a running mean (3,) learn; along and across count alike."""
    sample[:2] = sample[:2].mean()
    mean[:] = MEMORY * mean + (1.0 - MEMORY) * sample
