"""The improved proposal: particles are drawn where the motion and the scan agree.

Grisetti, Stachniss, Burgard, "Improved techniques for grid mapping with Rao-Blackwellized
particle filters" (2007). The optimal proposal p(x_t | m, x_{t-1}, z_t, u_t) is proportional to
p(z_t | x_t, m) p(x_t | x_{t-1}, u_t) (their eq. 9). The paper fits a Gaussian to samples around the
scan matcher's result; here it is Laplace's: the mean is the maximum, found by Gauss-Newton, and
the covariance the inverse of the Hessian there.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mapmyworld.config import ParticlesConfig
from mapmyworld.geometry.planar import compose_planar, wrap_angle
from mapmyworld.parallel import run_in_chunks
from mapmyworld.particles import kernels
from mapmyworld.particles.kernels import Beams
from mapmyworld.particles.motions import Motion
from mapmyworld.particles.tiles import TileMaps

_MAX_DISTANCES = np.array([7, 6, 5, 4, 4, 4, 4, 4], np.int64)
"""Cells searched around end points: neighbouring beams of a coarse scan end as far apart."""
_MISLEADING = 0.1
"""Probability that a scan indicates nothing of its pose: where it contradicts the odometry, it may
have been taken at another moment, or fit a wrong place better than the right one."""


@dataclass(frozen=True, slots=True, eq=False)
class Proposal:
    """A mixture of M Gaussians a particle."""

    mean: NDArray[np.float64]
    """(P, M, 3) map frame."""
    covariance: NDArray[np.float64]
    """(P, M, 3, 3) map frame's axes."""
    log_mass: NDArray[np.float64]
    """(P, M) log p(z_t, mode | m, x_{t-1}, u_t), up to a constant: no mode is ruled out."""
    share: NDArray[np.float64]
    """(P, M) share of the beams that the map explains."""

    @property
    def log_weight(self) -> NDArray[np.float64]:
        """(P,) log p(z_t | m, x_{t-1}, u_t), likewise."""
        return np.asarray(np.logaddexp.reduce(self.log_mass, axis=1))

    def sample(self, random: np.random.Generator) -> NDArray[np.float64]:
        """x_t (P, 3), one from each particle's mixture."""
        count = np.arange(len(self.mean))
        noise = random.standard_normal((len(count), 3))
        cumulated = np.cumsum(np.exp(self.log_mass - self.log_weight[:, None]), axis=1)
        mode = np.sum(cumulated[:, :-1] < random.random((len(count), 1)), axis=1)
        root = np.linalg.cholesky(self.covariance[count, mode])
        x = self.mean[count, mode] + np.einsum("pij,pj->pi", root, noise)
        x[:, 2] = wrap_angle(x[:, 2])
        return np.asarray(x)


def improved_proposal(
    x: NDArray[np.float64],
    motion: Motion,
    z: Beams,
    m: TileMaps,
    config: ParticlesConfig,
    threads: int,
) -> Proposal:
    """Where particles at `x` (P, 3) go after a motion that ended with the scan z."""
    modes = [
        _mode(x, u, covariance, z, m, config, threads)
        for u, covariance in zip(motion.u, motion.covariance, strict=True)
    ]
    mean, covariance, log_mass, share = (
        np.stack(some, axis=1) for some in zip(*modes, strict=True)
    )
    misleading = log_mass.max(axis=1, keepdims=True) + np.log(_MISLEADING)
    return Proposal(mean, covariance, np.logaddexp(log_mass, misleading), share)


def _mode(
    x: NDArray[np.float64],
    u: NDArray[np.float64],
    u_covariance: NDArray[np.float64],
    z: Beams,
    m: TileMaps,
    config: ParticlesConfig,
    threads: int,
) -> tuple[NDArray[np.float64], ...]:
    """One Gaussian of the motion, after the scan: mean, covariance, log mass, share."""
    count = len(x)
    scale = min(1.0, config.beams_effective / max(len(z.points), 1))
    predicted = compose_planar(x, u)
    mean, information = np.zeros((count, 3)), np.zeros((count, 3, 3))
    quality = np.zeros((count, 3))
    prior = np.asarray(np.linalg.inv(u_covariance), np.float64)

    def match(first: int, last: int) -> None:
        kernels.match(
            m.surfaces, first, last, z, predicted, prior, _MAX_DISTANCES, config.sigma, scale,
            mean, information, quality,
        )  # fmt: skip

    run_in_chunks(match, count, threads)
    covariance = np.asarray(np.linalg.inv(information), np.float64)
    # Laplace: the integral of exp(-cost) is exp(-minimum) times the root of |2 pi Sigma|.
    volume = 0.5 * (np.linalg.slogdet(covariance)[1] - np.linalg.slogdet(u_covariance)[1])
    return mean, covariance, scale * quality[:, 1] - 0.5 * quality[:, 2] + volume, quality[:, 0]
