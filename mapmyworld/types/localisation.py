"""What localisation reports about every moment of a log."""

from __future__ import annotations

import itertools
from dataclasses import dataclass
from enum import StrEnum

import numpy as np

from mapmyworld.geometry import Array
from mapmyworld.geometry.rigid import invert
from mapmyworld.types.maps import Trajectory


class State(StrEnum):
    """What was known at a moment, from that moment and those before it."""

    LOST = "lost"
    TRACKING = "tracking"
    RECOGNISED = "recognised"


@dataclass(frozen=True, slots=True, eq=False)
class Estimate:
    """One moment."""

    stamp_ns: int
    map_from_base: Array
    """(4, 4); while lost, where dead reckoning puts the robot, or where it was found afterwards."""
    covariance: Array
    """(6, 6), rotation first, of the right perturbation of `map_from_base`."""
    state: State
    fit: float
    """Share of the observation that the map explains, 0 to 1."""
    known: bool
    """Whether the pose is believed: tracked, or worked out backwards from a later recognition."""
    odom_from_base: Array | None
    """(4, 4) recorded odometry, where the log has it."""

    @property
    def map_from_odom(self) -> Array | None:
        """The correction (4, 4) of the odometry; None where the log has none."""
        if self.odom_from_base is None:
            return None
        return np.asarray(self.map_from_base @ invert(self.odom_from_base))


@dataclass(frozen=True, slots=True, eq=False)
class Localisation:
    """A log in a map."""

    estimates: tuple[Estimate, ...]
    notes: tuple[str, ...]
    losses: tuple[str, ...]

    @property
    def trajectory(self) -> Trajectory:
        """The poses that are known."""
        known = [e for e in self.estimates if e.known]
        stamps = np.array([e.stamp_ns for e in known], np.int64)
        return Trajectory(stamps, np.array([e.map_from_base for e in known]).reshape(-1, 4, 4))

    def share(self, state: State) -> float:
        """Share of the moments in a state."""
        count = sum(e.state == state for e in self.estimates)
        return count / max(len(self.estimates), 1)

    @property
    def known_share(self) -> float:
        """Share of the moments whose pose is known."""
        return sum(e.known for e in self.estimates) / max(len(self.estimates), 1)

    @property
    def recognised_after_s(self) -> float | None:
        """Seconds from the first moment to the first recognition; None if there was none."""
        for estimate in self.estimates:
            if estimate.state != State.LOST:
                return (estimate.stamp_ns - self.estimates[0].stamp_ns) * 1e-9
        return None

    @property
    def times_lost(self) -> int:
        """How often the place was lost after it had been known."""
        states = [e.state for e in self.estimates]
        pairs = itertools.pairwise(states)
        return sum(a != State.LOST and b == State.LOST for a, b in pairs)
