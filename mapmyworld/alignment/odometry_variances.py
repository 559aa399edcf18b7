"""Odometry in the joint alignment: calibrated by the scans, with the noise that they show of it.

Between two scans goes what the wheels recorded, not what was tracked: tracking compared the same
points as pairs of scans do. What motions err by, along, across and in heading, are three variance
components (Helmert 1907; Koch, "Parameter estimation and hypothesis testing in linear models",
1999, 3.6): squared residuals over redundancy, the share of each that the other measurements check.
Where none shows how far a corridor goes nothing is learnt of it.
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
from mapmyworld.geometry.planar import between_planar, matrix_to_planar, wrap_angle
from mapmyworld.graph.covariance import relative_covariances
from mapmyworld.kernels.wheel_model import (
    ERRORS,
    FIRST_NOISE,
    FIRST_SIGMAS,
    METRES_PER_RADIAN,
    MOVES,
    OUTLIER,
    RADIANS_PER_METRE,
    error_jacobians,
)
from mapmyworld.types import Node

_ASKED = 256  # motions that variances are learnt from in a step
_LEAST = 1e-6  # m^2 per m and rad^2 per rad, which no odometry is better than
_START = 10  # fits of systematic errors from none, each weighed by the one before


class WeighedOdometry:
    """The odometry between S scans of K sessions."""

    errors: Array
    """(K, 6) systematic ones: see `kernels.wheel_model`."""
    noise: Array
    """(K, 3) variances of motions along, across and in heading: m^2, rad^2, a metre or radian."""
    trusted: NDArray[np.bool_]
    """(E,) motions that count, and are no faults of the odometry."""

    def __init__(
        self, nodes: Sequence[Node], chosen: Index, tracked: Edges, matched: NDArray[np.bool_]
    ) -> None:
        """Between `chosen` nodes (S,), by what it misses the `tracked` motions (E,) at first.

        These count where there is no odometry, or it is at fault, or the robot stood; and if not
        `matched` (E,): they are odometry then, and tracking knows of stalls.
        """
        recorded = matrix_to_planar(np.stack([node.odom_from_base for node in nodes]))
        steps = between_planar(recorded[:-1], recorded[1:])
        path = np.append(0.0, np.cumsum(np.hypot(steps[:, 0], steps[:, 1])))
        turned = np.append(0.0, np.cumsum(np.abs(wrap_angle(steps[:, 2]))))
        self._tails, self._heads = tracked[:2]
        session = [nodes[k].session for k in chosen.tolist()]
        every, of_scan = np.unique(session, return_inverse=True)
        self._of = of_scan[self._tails]  # the session of each motion
        before, after = chosen[self._tails], chosen[self._heads]
        metres, radians = path[after] - path[before], turned[after] - turned[before]
        position = metres + METRES_PER_RADIAN * radians
        heading = radians + RADIANS_PER_METRE * metres
        self._recorded = between_planar(recorded[before], recorded[after])
        self._lengths = np.maximum(np.stack([position, position, heading], axis=1), MOVES)
        told = np.abs(self._recorded - tracked[2]).max(axis=1) > 1e-9  # else the tracker's own
        self._usable = matched & told & (metres + radians > MOVES)
        self._tracked, self.trusted = tracked, self._usable
        self.errors = np.zeros((len(every), ERRORS))
        self.noise = np.full((len(every), 3), FIRST_NOISE)
        for k in np.unique(self._of).tolist():
            self._begin(k, tracked[2])

    def _begin(self, k: int, found: Array) -> None:
        """A session's first noise, where the motions `found` (E, 3) are right.

        It starts too large: motions that are no faults by it show less, and so on.
        """
        for _ in range(_START):
            self._trust(found)
            self._calibrate(k, found)
            use = self._trusted_of(k)
            missed, variances = self._missed(found)[use], self._variances()[use]
            change = _change(missed, 0.0 * missed, variances)
            self.noise[k] = np.maximum(self.noise[k] * change, _LEAST)

    def added_to(self, system: System) -> System:
        """The system, whose first nodes are the scans, with the odometry behind its edges."""
        rows, faults = np.flatnonzero(self.trusted), np.flatnonzero(~self.trusted)
        ends, variances = (self._tails[rows], self._heads[rows]), self._variances()[rows]
        joint = with_edges(system, *ends, self._measured()[rows], diagonals(1.0 / variances))
        tails, heads, measured, information = self._tracked
        ends = tails[faults], heads[faults]
        return with_edges(joint, *ends, measured[faults], information[faults])

    def learn(self, joint: System, poses: Array) -> None:
        """One step to the variances that the system, solved by `poses` (N, 3), shows."""
        found = between_planar(poses[self._tails], poses[self._heads])
        missed, count, variances = self._missed(found), len(self.noise), self._variances()
        asked = _some(np.flatnonzero(self.trusted), self._of, count)
        try:
            known = relative_covariances(joint, poses, self._tails[asked], self._heads[asked])
        except NotPositiveDefiniteError:
            return
        for k in range(count):
            mine = self._of[asked] == k
            rows = asked[mine]
            change = _change(missed[rows], known[mine].diagonal(0, 1, 2), variances[rows])
            self.noise[k] = np.maximum(self.noise[k] * change, _LEAST)
            x, y, yaw = np.sqrt(self.noise[k]).tolist()
            decided(
                "refine",
                f"odometry errs by {x:.4f} m, {y:.4f} m, {np.degrees(yaw):.2f} deg a metre along, "
                "across and in heading",
            )
            self._calibrate(k, found)
        self._trust(found)

    def _calibrate(self, k: int, found: Array) -> None:
        """Systematic errors, fitted to motions that were `found` (E, 3).

        By the rotation that was found: noise of the recorded one would make it less.
        """
        use, self.errors[k] = self._trusted_of(k), 0.0
        weight = 1.0 / self._variances()[use]
        rows = error_jacobians(self._recorded[use], found[use, 2])
        missed = self._missed(found)[use]
        weighed = rows.swapaxes(1, 2) * weight[:, None]
        normal = np.sum(weighed @ rows, axis=0) + np.diag(1.0 / np.square(FIRST_SIGMAS))
        self.errors[k] = np.linalg.solve(normal, np.sum(weighed @ missed[:, :, None], axis=0))[:, 0]

    def _trust(self, found: Array) -> None:
        """Which motions are no faults of the odometry."""
        squares = np.sum(self._missed(found) ** 2 / self._variances(), axis=1)
        self.trusted = np.asarray(self._usable & (squares < OUTLIER))

    def _trusted_of(self, k: int) -> Index:
        return np.flatnonzero(self.trusted & (self._of == k))

    def _missed(self, found: Array) -> Array:
        missed = found - self._measured()
        missed[:, 2] = wrap_angle(missed[:, 2])
        return np.asarray(missed)

    def _measured(self) -> Array:
        """(E, 3) recorded motions without systematic errors."""
        errors, (x, _, turn) = self.errors[self._of], self._recorded.T
        turned = (turn + errors[:, 4] * x) / (1.0 - errors[:, 5])
        change = error_jacobians(self._recorded, turned) @ errors[:, :, None]
        return np.asarray(self._recorded + change[:, :, 0])

    def _variances(self) -> Array:
        return np.asarray(self.noise[self._of] * self._lengths)


def _change(missed: Array, known: Array, variances: Array) -> Array:
    """(3,) by what `variances` (E, 3) change, after residuals that `missed` (E, 3) zero.

    The solution knows the measurements by `known` (E, 3); the better, the less redundant they are.
    One more residual is as large as was believed: where nothing is redundant nothing changes.
    """
    redundancy = np.clip(1.0 - known / variances, 0.0, 1.0)
    squares = missed**2 / variances
    return np.asarray((1.0 + squares.sum(axis=0)) / (1.0 + redundancy.sum(axis=0)))


def _some(rows: Index, session: Index, count: int) -> Index:
    """Up to `_ASKED` rows (R,) of each of so many sessions, evenly; `session` (N,) is of all."""
    of_each = [rows[session[rows] == k] for k in range(count)]
    places = [np.linspace(0, len(r) - 1, min(len(r), _ASKED)).astype(np.int64) for r in of_each]
    return np.concatenate([r[at] for r, at in zip(of_each, places, strict=True)])
