"""Odometry in the joint alignment: calibrated by the scans, with the noise that they show of it.

Between two scans goes what the wheels recorded, not what was tracked: tracking compared the same
points as pairs of scans do. Where none shows how far a corridor goes nothing is learnt of it.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from mapmyworld.alignment.joint_system import Edges
from mapmyworld.backend.block_matrix import diagonals
from mapmyworld.backend.information import NotPositiveDefiniteError
from mapmyworld.backend.system import System, with_edges
from mapmyworld.decisions import decided
from mapmyworld.geometry import Array, Index
from mapmyworld.geometry.planar import between_planar
from mapmyworld.graph.covariance import relative_covariances
from mapmyworld.odometry.motion_calibration import CalibratedMotions
from mapmyworld.types import Node

_ASKED = 256  # motions that variances are learnt from in a step


class WeighedOdometry(CalibratedMotions):
    """The odometry between S scans of K sessions."""

    def __init__(
        self, nodes: Sequence[Node], chosen: Index, tracked: Edges, matched: NDArray[np.bool_]
    ) -> None:
        """Between `chosen` nodes (S,), by what it misses the `tracked` motions (E,) at first.

        These count where there is no odometry, or it is at fault, or the robot stood; and if not
        `matched` (E,): they are odometry then, and tracking knows of stalls.
        """
        self._tracked = tracked
        self._tails, self._heads, found, _ = tracked
        super().__init__(nodes, (chosen[self._tails], chosen[self._heads]), found, matched)

    def added_to(self, system: System) -> System:
        """The system, whose first nodes are the scans, with the odometry behind its edges."""
        rows, faults = np.flatnonzero(self.trusted), np.flatnonzero(~self.trusted)
        ends, variances = (self._tails[rows], self._heads[rows]), self.variances()[rows]
        joint = with_edges(system, *ends, self.measured()[rows], diagonals(1.0 / variances))
        tails, heads, measured, information = self._tracked
        ends = tails[faults], heads[faults]
        return with_edges(joint, *ends, measured[faults], information[faults])

    def learn(self, joint: System, poses: Array) -> None:
        """One step to the variances that the system, solved by `poses` (N, 3), shows."""
        found = between_planar(poses[self._tails], poses[self._heads])
        asked = _some(np.flatnonzero(self.trusted), self.session, len(self.noise))
        try:
            known = relative_covariances(joint, poses, self._tails[asked], self._heads[asked])
        except NotPositiveDefiniteError:
            return
        for k in range(len(self.noise)):
            mine = self.session[asked] == k
            self.learn_noise(k, asked[mine], found, known[mine].diagonal(0, 1, 2))
            x, y, yaw = np.sqrt(self.noise[k]).tolist()
            decided(
                "refine",
                f"odometry errs by {x:.4f} m, {y:.4f} m, {np.degrees(yaw):.2f} deg a metre along, "
                "across and in heading",
            )
            self.calibrate(k, found)
        self.trust(found)


def _some(rows: Index, session: Index, count: int) -> Index:
    """Up to `_ASKED` rows (R,) of each of so many sessions, evenly; `session` (N,) is of all."""
    of_each = [rows[session[rows] == k] for k in range(count)]
    places = [np.linspace(0, len(r) - 1, min(len(r), _ASKED)).astype(np.int64) for r in of_each]
    return np.concatenate([r[at] for r, at in zip(of_each, places, strict=True)])
