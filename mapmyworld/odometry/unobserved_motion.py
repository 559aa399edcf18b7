"""How far a robot may get while nothing observes it, learnt from how it moves while scans do.

Constant velocity, and white acceleration: after t seconds the variances are q t^3 / 3 (Bar-Shalom,
Li and Kirubarajan, "Estimation with applications to tracking and navigation", 2001, section 6.2);
or 2 v^2 t^2, where that is less: another velocity of those that the robot has.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike, NDArray

from mapmyworld.geometry import Array
from mapmyworld.geometry.planar import between_planar, planar_exp, planar_log
from mapmyworld.kernels.wheel_model import MEMORY, MOVES

GOES_ON = 1.0
"""Seconds for which a motion is expected to go on as it was, and the next is compared with it."""
FARTHEST = 1e3
"""Metres: farther than maps reach."""
ANYWHERE = np.square([FARTHEST, FARTHEST, np.pi])
"""m^2, m^2, rad^2 of a pose that is not known at all."""
_SUBMAP = 5.0  # m about that a submap shows around a robot


class UnobservedMotion:
    """When scans last showed where the robot was, and what may have become of it since.

    By the last second's motion, and how fast and how steadily the robot has moved so far. Some
    logs' stamps step back: what counts is the latest so far.
    """

    def __init__(self) -> None:
        self._acceleration = np.ones(3)  # m^2/s^3, m^2/s^3, rad^2/s^3, before anything was seen
        self._square_velocity = np.ones(3)  # m^2/s^2, m^2/s^2, rad^2/s^2
        self._last_ns = self._placed_ns = 0  # of the last frame, and of the last that was placed
        self._since, self._pose = 0.0, np.zeros(3)
        self._moved, self._took = np.zeros(3), 0.0

    @property
    def is_placed(self) -> bool:
        """Whether the last frame's scan showed where the robot was."""
        return self._placed_ns == self._last_ns

    def begin(self, stamp_ns: int, pose: Array) -> None:
        """The first frame of a submap, at a pose (3,), whose velocity is unknown."""
        self._last_ns = self._placed_ns = max(self._last_ns, stamp_ns)
        self._since, self._pose = 1e-9 * self._last_ns, pose.copy()
        self._took = 0.0

    def take(self, stamp_ns: int, pose: Array | None) -> None:
        """One more frame, and its pose (3,) where its scan shows it."""
        self._last_ns = max(self._last_ns, stamp_ns)
        if pose is None:
            return
        self._placed_ns = self._last_ns
        took = 1e-9 * self._last_ns - self._since
        if took < GOES_ON:
            return
        moved = between_planar(self._pose, pose)
        if self._took and max(np.hypot(*moved[:2]), abs(moved[2])) > MOVES:
            error = between_planar(self._expected(took), moved)
            _learn(self._acceleration, 3.0 * error**2 / took**3)
            _learn(self._square_velocity, (moved / took) ** 2)
        self._moved, self._took = moved, took
        self._since, self._pose = 1e-9 * self._last_ns, pose.copy()

    def goes_on(self, stamp_ns: int) -> bool:
        """Whether the next frame comes so soon that its step is like the last."""
        return self._seconds(self._last_ns, stamp_ns) <= GOES_ON

    def step(self, stamp_ns: int, last: Array) -> Array:
        """The motion (3,) expected to the next frame: like the last (3,), or as long as it took."""
        if self.goes_on(stamp_ns):
            return last
        return self._expected(self._seconds(self._last_ns, stamp_ns))

    def variances(self, stamp_ns: int) -> Array:
        """(3,) m^2, m^2, rad^2, by which the robot may be off its way since it was placed."""
        return self._variances(self._seconds(self._placed_ns, stamp_ns))

    def may_have_left(self, stamp_ns: int) -> bool:
        """Whether the robot may be beyond what the submap shows since it was placed."""
        return bool(self._leaves(self._seconds(self._placed_ns, stamp_ns)))

    def gaps(self, stamps_ns: Sequence[int]) -> NDArray[np.bool_]:
        """(B,) whether each frame comes so long after the one before that nobody saw the way."""
        return self._waits(stamps_ns) > GOES_ON

    def way(self, stamp_ns: int) -> Array:
        """Metres and radians (2,) that the robot went unseen to the next frame, as fast as usual.

        None of it was unseen unless that comes after a gap.
        """
        if self.goes_on(stamp_ns):
            return np.zeros(2)
        x, y, yaw = self._square_velocity
        return np.asarray(np.sqrt([x + y, yaw]) * self._seconds(self._last_ns, stamp_ns))

    def leaps(self, stamps_ns: Sequence[int]) -> NDArray[np.bool_]:
        """(B,) whether it may be so far since the frame before alone."""
        return self._leaves(self._waits(stamps_ns))

    def _waits(self, stamps_ns: Sequence[int]) -> Array:
        """Seconds (B,) since the frame before each."""
        stamps = np.maximum.accumulate(np.array([self._last_ns, *stamps_ns]))
        return 1e-9 * np.diff(stamps)

    def _seconds(self, then_ns: int, stamp_ns: int) -> float:
        return 1e-9 * (max(self._last_ns, stamp_ns) - then_ns)

    def _expected(self, seconds: float) -> Array:
        """The motion (3,) of so many seconds: it goes on as it did, and then stays."""
        if not self._took or self._leaves(seconds):
            return np.zeros(3)
        return planar_exp(planar_log(self._moved) * (seconds / self._took))

    def _variances(self, seconds: ArrayLike) -> Array:
        """(..., 3) m^2, m^2, rad^2, of how far off that may be after so long (...)."""
        seconds = np.asarray(seconds, np.float64)[..., None]
        smooth = self._acceleration * seconds**3 / 3.0
        varied = 2.0 * self._square_velocity * seconds**2
        return np.minimum(np.minimum(smooth, varied), ANYWHERE)

    def _leaves(self, seconds: ArrayLike) -> NDArray[np.bool_]:
        """(...) whether after so long (...) the robot may be beyond what a submap shows."""
        return np.asarray(3.0 * np.sqrt(self._variances(seconds)[..., 0]) > _SUBMAP)


def _learn(mean: Array, sample: Array) -> None:
    """Lets a running mean (3,) learn; along and across count alike."""
    sample[:2] = sample[:2].mean()
    mean[:] = MEMORY * mean + (1.0 - MEMORY) * sample
