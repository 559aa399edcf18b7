"""Recorded motions, calibrated by what scans or images found them to be.

What motions err by for every metre and radian, along, across and in heading, are variance
components (Helmert 1907; Koch, "Parameter estimation and hypothesis testing in linear models",
1999, 3.6): squared residuals over redundancy, the share of each that other measurements check.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from mapmyworld.geometry import Array, Index
from mapmyworld.geometry.planar import between_planar, matrix_to_planar, wrap_angle
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

_LEAST = 1e-6  # m^2 per m and rad^2 per rad, which no odometry is better than
_EXACTLY = 1e-9  # m and rad up to which a motion was found by the odometry itself
_START = 10  # fits of systematic errors from none, each weighed by the one before


class CalibratedMotions:
    """What the odometry recorded between E pairs of nodes of K sessions."""

    errors: Array
    """(K, 6) systematic ones: see `kernels.wheel_model`."""
    noise: Array
    """(K, 3) variances of motions along, across and in heading: m^2, rad^2, a metre or radian."""
    session: Index
    """(E,) the number of each motion's session, of K."""
    trusted: NDArray[np.bool_]
    """(E,) motions that were found, and are no faults of the odometry."""

    def __init__(
        self,
        nodes: Sequence[Node],
        ends: tuple[Index, Index],
        found: Array,
        is_found: NDArray[np.bool_],
        is_open: NDArray[np.bool_] | None = None,
    ) -> None:
        """From node to node, by indices `ends` (E,), first calibrated by motions `found` (E, 3).

        These count where each `is_found` (E,), the robot moved, and they are not those recorded.
        Where one `is_open` (E,) along walls its position is the odometry's, and shows no scale.
        """
        odometry = matrix_to_planar(np.stack([node.odom_from_base for node in nodes]))
        steps = between_planar(odometry[:-1], odometry[1:])
        path = np.append(0.0, np.cumsum(np.hypot(steps[:, 0], steps[:, 1])))
        turned = np.append(0.0, np.cumsum(np.abs(wrap_angle(steps[:, 2]))))
        every, of_node = np.unique([node.session for node in nodes], return_inverse=True)
        self._tails, self._heads = before, after = ends
        self.session = of_node[before]
        self.recorded = between_planar(odometry[before], odometry[after])
        metres, radians = path[after] - path[before], turned[after] - turned[before]
        moves = metres + radians > MOVES
        # As long as what was found: noise of the recorded way would weigh its own errors.
        metres = np.maximum(metres + _length(found) - _length(self.recorded), 0.0)
        radians = np.maximum(radians + np.abs(found[:, 2]) - np.abs(self.recorded[:, 2]), 0.0)
        position = metres + METRES_PER_RADIAN * radians
        heading = radians + RADIANS_PER_METRE * metres
        self._shows = np.ones((len(found), 3), np.bool_)
        if is_open is not None:
            self._shows[is_open, :2] = False
        self._lengths = np.maximum(np.stack([position, position, heading], axis=1), MOVES)
        told = np.abs(self.recorded - found).max(axis=1) > _EXACTLY
        self._usable = np.asarray(is_found & told & moves)
        self.trusted = self._usable
        self.errors = np.zeros((len(every), ERRORS))
        self.noise = np.full((len(every), 3), FIRST_NOISE)
        self._scatter = self.noise.copy()  # the same of all that motions miss, scans' part with it
        for k in np.unique(self.session).tolist():
            self._begin(k, found)

    def _begin(self, k: int, found: Array) -> None:
        """A session's first noise, where the motions `found` (E, 3) are right.

        It starts too large: motions that are no faults by it show less, and so on.
        """
        for _ in range(_START):
            self.trust(found)
            self.calibrate(k, found)
            self._learn_noise(k, found)

    def measured(self) -> Array:
        """(E, 3) recorded motions without systematic errors."""
        errors, (x, _, turn) = self.errors[self.session], self.recorded.T
        turned = (turn + errors[:, 4] * x) / (1.0 - errors[:, 5])
        change = error_jacobians(self.recorded, turned) @ errors[:, :, None]
        return np.asarray(self.recorded + change[:, :, 0])

    def variances(self) -> Array:
        """(E, 3) of the measured motions by their noise: m^2 and rad^2."""
        return np.asarray(self.noise[self.session] * self._lengths)

    def missed(self, found: Array) -> Array:
        """(E, 3) by what motions `found` (E, 3) differ from those measured."""
        missed = found - self.measured()
        missed[:, 2] = wrap_angle(missed[:, 2])
        return np.asarray(missed)

    def _learn_noise(self, k: int, found: Array) -> None:
        """One step to the noise of session `k` that its motions, `found` (E, 3), show.

        What a scan errs by ends one motion and begins the next one: with the products of successive
        residuals it cancels (Roll, "A simple implicit measure of the effective bid-ask spread",
        Journal of Finance 39, 1984). One more residual is as large as was believed: where there are
        few, little changes.
        """
        use = self._trusted_of(k)
        missed = self.missed(found)[use] / np.sqrt(self._lengths[use])
        follows = self._tails[use[1:]] == self._heads[use[:-1]]
        products, count = np.sum((missed[1:] * missed[:-1])[follows], axis=0), 1.0 + len(use)
        every = (self._scatter[k] + np.sum(missed**2, axis=0)) / count
        least = every * np.sqrt(6.0 / count)  # the standard error of what is left
        self._scatter[k] = np.maximum(every, _LEAST)
        self.noise[k] = np.maximum(every + 2.0 * products / count, np.maximum(least, _LEAST))

    def calibrate(self, k: int, found: Array) -> None:
        """Systematic errors of session `k`, fitted to motions that were `found` (E, 3).

        Instruments are the likeliest motions, for what these err by is in no residual (Fuller,
        "Measurement error models", 1987, 1.4): noise of the recorded ones would make the scale
        smaller, that of the found ones larger.
        """
        use, self.errors[k] = self._trusted_of(k), 0.0
        weight, turned = self._shows[use] / self._scattered()[use], found[use, 2]
        missed, recorded = self.missed(found)[use], self.recorded[use]
        share = np.minimum(self.noise[k] / self._scatter[k], 1.0)  # of residuals, the odometry's
        rows, true = (error_jacobians(m, turned) for m in (recorded, recorded + share * missed))
        weighed = true.swapaxes(1, 2) * weight[:, None]
        normal = np.sum(weighed @ rows, axis=0) + np.diag(1.0 / np.square(FIRST_SIGMAS))
        self.errors[k] = np.linalg.solve(normal, np.sum(weighed @ missed[:, :, None], axis=0))[:, 0]

    def trust(self, found: Array) -> None:
        """Which motions, `found` (E, 3) to be these, are no faults of the odometry."""
        squares = np.sum(self.missed(found) ** 2 / self._scattered(), axis=1)
        self.trusted = np.asarray(self._usable & (squares < OUTLIER))

    def _scattered(self) -> Array:
        return np.asarray(self._scatter[self.session] * self._lengths)

    def _trusted_of(self, k: int) -> Index:
        return np.flatnonzero(self.trusted & (self.session == k))


def _length(motions: Array) -> Array:
    return np.hypot(motions[:, 0], motions[:, 1])
