"""Motion between the filter's updates, by the odometry, and by scan matching where that fails.

Tracking has calibrated the wheels by the whole log, and shows how much they err: what it finds
between two updates, less what they indicate, is one sample. The odometry with this noise is the
prior of all particles. Where tracking contradicts it, one of the two is at fault: wheels stall and
slip, and a scan may fit a wrong place better than the right one. Then tracking is a second mode of
the mixture that particles are drawn from, as likely beforehand as faults are in this log.
"""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from mapmyworld.config import OdometryConfig
from mapmyworld.geometry import Array
from mapmyworld.geometry.planar import between_planar, wrap_angle
from mapmyworld.kernels.wheel_model import POSE, TRAVELLED, anchor, random_variances, reckon

_MEDIANS = np.array([2.0 * np.log(2.0), 0.4549])
"""Of the chi-squared distributions of two degrees of freedom, x and y, and of one, yaw."""


@dataclass(frozen=True, slots=True, eq=False)
class Motion:
    """p(x_t | x_{t-1}, u_t) from one update of the filter to the next: a mixture of Gaussians."""

    u: Array
    """(M, 3) in the frame of its start."""
    covariance: Array
    """(M, 3, 3) in the body frame."""
    probability: Array
    """(M,) of each mode."""

    @property
    def is_contradicted(self) -> bool:
        """Whether tracking contradicts the odometry, which is the first of two modes then."""
        return len(self.u) > 1

    def nearest(self, step: Array) -> int:
        """The mode that a motion (3,) belongs to."""
        miss = between_planar(self.u, step)
        miss[:, 2] = wrap_angle(miss[:, 2])
        weights = np.linalg.inv(self.covariance)
        return int(np.argmin(np.einsum("mi,mij,mj->m", miss, weights, miss)))


def motions_between(
    updates: Sequence[int],
    tracked: Array,
    covariances: Array,
    recorded: Array,
    wheels: Array,
    config: OdometryConfig,
) -> list[Motion]:
    """The motions (K - 1) between K updates, which are numbers of scans.

    Of all F scans the `tracked` poses (F, 3), the `covariances` (F, 3, 3) of the motions from the
    scans before, and these as `recorded` (F, 3) by the odometry, NaN where unknown. `wheels` (56,)
    are its calibration: see `kernels.wheel_model`.
    """
    moved, by_tracking = tracked_between(updates, tracked, covariances)
    wheels, spans = wheels.copy(), itertools.pairwise(updates)
    reckoned = np.array([_reckoned(recorded[a + 1 : b + 1], wheels) for a, b in spans])
    reckoned = reckoned.reshape(-1, 5)
    miss = between_planar(reckoned[:, :3], moved)
    variances = _variances(reckoned, miss)
    fault = np.sum(miss**2 / variances, axis=1) > config.contradiction**2
    faults = (np.count_nonzero(fault) + 1) / (len(moved) + 2)
    motions = []
    for k, (u, covariance) in enumerate(zip(moved, by_tracking, strict=True)):
        odometry = np.diag(variances[k])
        if np.isnan(variances[k, 0]):
            motions.append(Motion(u[None], covariance[None], np.ones(1)))
        elif not fault[k]:
            motions.append(Motion(reckoned[k : k + 1, :3], odometry[None], np.ones(1)))
        else:
            both, p = np.stack([reckoned[k, :3], u]), np.array([1.0 - faults, faults])
            motions.append(Motion(both, np.stack([odometry, covariance]), p))
    return motions


def tracked_between(
    updates: Sequence[int], tracked: Array, covariances: Array
) -> tuple[Array, Array]:
    """Motions (K - 1, 3) between K updates by tracking alone, and their covariances (K - 1, 3, 3).

    Of all F scans the `tracked` poses (F, 3), and the `covariances` (F, 3, 3) as they are given to
    `motions_between`.
    """
    at = np.asarray(updates, np.int64)
    moved = between_planar(tracked[at[:-1]], tracked[at[1:]])
    summed = [covariances[a + 1 : b + 1].sum(axis=0) for a, b in itertools.pairwise(updates)]
    return moved, np.reshape(summed, (-1, 3, 3))


def _reckoned(steps: Array, wheels: Array) -> Array:
    """(5,) motion by steps (S, 3) of calibrated wheels (56,), path m, rotation rad; NaN."""
    anchor(wheels, np.zeros(3))
    for step in steps:
        reckon(wheels, step)
    return np.append(wheels[POSE], wheels[TRAVELLED])


def _variances(reckoned: Array, miss: Array) -> Array:
    """Variances (K, 3) of the motions `reckoned` (K, 5), by what they `miss` (K, 3) tracking by.

    Medians: faults, which are few, do not count.
    """
    squares = np.column_stack([(miss[:, :2] ** 2).sum(axis=1), miss[:, 2] ** 2])
    known = reckoned[:, 3:].sum(axis=1) > 0.0
    samples = squares[known] / _of_noise(np.ones(2), reckoned[known])[:, 1:]
    noise = np.median(samples, axis=0) / _MEDIANS if len(samples) else np.ones(2)
    return _of_noise(noise, reckoned)


def _of_noise(noise: Array, reckoned: Array) -> Array:
    """Variances (K, 3) that noise (2,) adds up to in the motions `reckoned` (K, 5)."""
    every = [random_variances(noise, way) for way in reckoned[:, 3:]]
    return np.reshape(every, (-1, 3))
