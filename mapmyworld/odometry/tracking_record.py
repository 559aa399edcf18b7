"""What is noticed while a laser is followed: faults of the odometry, scans that fit nothing."""

from __future__ import annotations

from collections import Counter

import numpy as np

from mapmyworld.geometry import Array
from mapmyworld.kernels.wheel_model import MOVES
from mapmyworld.odometry.degeneracy import DegenerateSections
from mapmyworld.odometry.laser_mount import notes as mount_notes
from mapmyworld.odometry.pose_hypotheses import FAULT
from mapmyworld.odometry.tracking_losses import named_moments


class TrackingRecord:
    """Counts of what became of steps and scans, and when."""

    def __init__(self) -> None:
        self.faults: Counter[str] = Counter()
        """Of the odometry, by their kinds."""
        self.compared = 0
        """Steps of which odometry and match are known."""
        self.verdicts: Counter[str] = Counter()
        """Of moments."""
        self.degenerate = DegenerateSections()
        self.lost_ns: list[int] = []
        self.first_ns: int | None = None

    def fault_share(self) -> float:
        """The share of faults so far, as if 1 / FAULT steps with one of them had been seen before:
        the probability of the next.
        """
        return (1.0 + self.faults.total()) / (1.0 / FAULT + self.compared)

    def notes(self, wheels: Array) -> tuple[str, ...]:
        """How far the odometry, a model (56,), can be trusted, and where tracking failed."""
        found = [
            f"odometry {kind} at {count} of {self.compared} scans"
            for kind, count in self.faults.most_common()
        ]
        found += [*mount_notes(wheels), *self.degenerate.notes()]
        if self.lost_ns:
            when = named_moments(self.lost_ns, self.first_ns or 0)
            found.append(f"tracking was lost at {when}: no scan match and no odometry")
        for verdict, text in _NOTES.items():
            if self.verdicts[verdict]:
                found.append(f"{self.verdicts[verdict]} scans {text}")
        return tuple(found)

    def losses(self) -> tuple[str, ...]:
        """That most scans reported nothing, where they did."""
        useless = self.verdicts["odometry only"] + self.verdicts["lost"]
        total = self.verdicts.total()
        if 2 * useless <= total:
            return ()
        return (
            f"{useless} of {total} scans match nothing seen before: check that ranges are in "
            "metres, angles in radians, and that the laser sees walls",
        )


def fault(recorded: Array, moved: Array) -> str:
    """The kind of a step, x, y, yaw, `recorded` otherwise than it `moved` by scans; (3,) both."""
    along = recorded[0] * moved[0]
    if along < 0 and min(abs(recorded[0]), abs(moved[0])) > MOVES:
        return "has the wrong sign"
    if np.abs(recorded).max() < MOVES:
        return "stalls while the robot moves"
    if np.abs(recorded - moved).max() > np.abs(moved).max():
        return "jumps"
    return "disagrees with the scans"


_NOTES = {
    "odometry ignored": "contradicted the odometry, which was ignored there",
    "odometry only": "could not be matched; their motion is taken from odometry",
    "lost": "could not be matched and have no odometry: constant velocity assumed",
}
