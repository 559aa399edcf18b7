"""When scans last showed where the robot was, and what may have become of it since."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from mapmyworld.geometry import Array
from mapmyworld.odometry.unobserved_motion import GOES_ON, UnobservedMotion


class Timeline:
    """Stamps of the last frame, and of the last one whose scan showed where the robot was.

    Some logs' stamps step back: what counts is the latest so far.
    """

    def __init__(self) -> None:
        self._motion = UnobservedMotion()
        self._last_ns = self._placed_ns = 0

    @property
    def is_placed(self) -> bool:
        """Whether the last frame's scan showed where the robot was."""
        return self._placed_ns == self._last_ns

    def begin(self, stamp_ns: int, pose: Array) -> None:
        """The first frame of a submap, at a pose (3,), whose velocity is unknown."""
        self._last_ns = self._placed_ns = max(self._last_ns, stamp_ns)
        self._motion.restart(1e-9 * self._last_ns, pose)

    def take(self, stamp_ns: int, pose: Array | None) -> None:
        """One more frame, and its pose (3,) where its scan shows it."""
        self._last_ns = max(self._last_ns, stamp_ns)
        if pose is not None:
            self._placed_ns = self._last_ns
            self._motion.add(1e-9 * self._last_ns, pose)

    def goes_on(self, stamp_ns: int) -> bool:
        """Whether the next frame comes so soon that its step is like the last."""
        return self._since(self._last_ns, stamp_ns) <= GOES_ON

    def step(self, stamp_ns: int, last: Array) -> Array:
        """The motion (3,) expected to the next frame: like the last (3,), or as long as it took."""
        if self.goes_on(stamp_ns):
            return last
        return self._motion.step(self._since(self._last_ns, stamp_ns))

    def variances(self, stamp_ns: int) -> Array:
        """(3,) m^2, m^2, rad^2, by which the robot may be off its way since it was placed."""
        return self._motion.variances(self._since(self._placed_ns, stamp_ns))

    def may_have_left(self, stamp_ns: int) -> bool:
        """Whether the robot may be beyond what the submap shows since it was placed."""
        return bool(self._motion.may_have_left(self._since(self._placed_ns, stamp_ns)))

    def leaps(self, stamps_ns: Sequence[int]) -> NDArray[np.bool_]:
        """(B,) whether it may be so far since the frame before alone."""
        stamps = np.maximum.accumulate(np.array([self._last_ns, *stamps_ns]))
        return self._motion.may_have_left(1e-9 * np.diff(stamps))

    def _since(self, then_ns: int, stamp_ns: int) -> float:
        return 1e-9 * (max(self._last_ns, stamp_ns) - then_ns)
