"""Motion between the filter's updates, by scan matching and by the odometry.

Tracking places each scan with the odometry as a prior, and calibrates the wheels on the way. Where
the two agree, tracking is the prior of all particles. Where they do not, one of them is at fault:
wheels stall and slip, and a scan may fit a wrong place better than the right one. Then each is a
mode of the mixture that particles are drawn from, and later scans decide between them.
"""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mapmyworld.config import OdometryConfig
from mapmyworld.geometry.planar import between_planar, wrap_angle
from mapmyworld.kernels.wheel_model import anchor, reckon, reckoned_variances

Array = NDArray[np.float64]


@dataclass(frozen=True, slots=True, eq=False)
class Motion:
    """p(x_t | x_{t-1}, u_t) from one update of the filter to the next: a mixture of Gaussians."""

    u: Array
    """(M, 3) in the frame of its start."""
    covariance: Array
    """(M, 3, 3) in the body frame."""

    def nearest(self, step: Array) -> int:
        """The mode that a motion (3,) belongs to."""
        miss = between_planar(self.u, step)
        miss[:, 2] = wrap_angle(miss[:, 2])
        weights = np.linalg.inv(self.covariance)
        return int(np.argmin(np.einsum("mi,mij,mj->m", miss, weights, miss)))


@dataclass(frozen=True, slots=True, eq=False)
class TrackedScans:
    """What tracking found out about all scans of a log."""

    poses: Array
    """(F, 3)."""
    covariances: Array
    """(F, 3, 3) of the motion from the scan before."""
    recorded: Array
    """(F, 3) the odometry's motion from the scan before; NaN where unknown."""
    wheels: Array
    """(15,) the odometry's calibration: see `kernels.wheel_model`."""


def motions_between(
    updates: Sequence[int], tracked: TrackedScans, config: OdometryConfig
) -> list[Motion]:
    """The motions (K - 1) between K updates, which are numbers of scans."""
    wheels = tracked.wheels.copy()
    return [
        _motion(first, last, tracked, wheels, config) for first, last in itertools.pairwise(updates)
    ]


def _motion(
    first: int, last: int, tracked: TrackedScans, wheels: Array, config: OdometryConfig
) -> Motion:
    steps = slice(first + 1, last + 1)
    moved = between_planar(tracked.poses[first], tracked.poses[last])
    covariance = tracked.covariances[steps].sum(axis=0)
    alone = Motion(moved[None], covariance[None])
    if np.isnan(tracked.recorded[steps]).any():
        return alone
    anchor(wheels, np.zeros(3))
    for step in tracked.recorded[steps]:
        reckon(wheels, step)
    u = wheels[8:11].copy()
    variances = reckoned_variances(wheels, config.relative_noise, config.absolute_noise)
    miss = between_planar(u, moved)
    if np.sum(miss**2 / variances) <= config.contradiction**2:
        return alone
    return Motion(np.stack([u, moved]), np.stack([np.diag(variances), covariance]))
