"""The improved proposal: particles are drawn where the motion and the scan agree.

Grisetti, Stachniss, Burgard, "Improved techniques for grid mapping with Rao-Blackwellized
particle filters" (2007). The optimal proposal p(x_t | m, x_{t-1}, z_t, u_t) is proportional to
p(z_t | x_t, m) p(x_t | x_{t-1}, u_t) (their eq. 9). As there, poses all over the motion's noise
are compared by the particle's own map, and the likeliest is climbed on from: a climb from the
odometry alone ends in the next optimum. The paper fits a Gaussian to samples around the result;
here it is Laplace's: the mean is the maximum, found by Gauss-Newton, and the covariance the inverse
of the Hessian there.

Where a motion has two modes, one scan cannot decide whether it or the odometry is at fault: the
scans after it take part (fixed-lag sampling: Beevers and Huang 2007).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mapmyworld.geometry.planar import compose_planar, planar_to_matrix, wrap_angle
from mapmyworld.geometry.rigid import transported
from mapmyworld.parallel import run_in_chunks
from mapmyworld.particles.kernels import matching
from mapmyworld.particles.kernels.surface_tiles import Beams
from mapmyworld.particles.motions import Motion
from mapmyworld.particles.tiles import TileMaps

MAX_DISTANCES = np.array([7, 6, 5, 4, 4, 4, 4, 4], np.int64)
"""Cells searched around end points: neighbouring beams of a coarse scan end as far apart."""
_BASIN = np.array([0.1, 0.1, 0.02])
"""m, m and rad from a pose within which a climb finds it."""
_SIGMAS = 2.5  # of the motion within which poses are compared,
_STEPS = 5  # and how many to each side at most


@dataclass(frozen=True, slots=True, eq=False)
class Proposal:
    """A mixture of M Gaussians a particle."""

    mean: NDArray[np.float64]
    """(P, M, 3) map frame."""
    covariance: NDArray[np.float64]
    """(P, M, 3, 3) map frame's axes."""
    log_mass: NDArray[np.float64]
    """(P, M) log p(z_t, mode | m, x_{t-1}, u_t), up to a constant."""
    chosen: NDArray[np.float64]
    """(P, M) probability that the mode is drawn, by the scans after z_t as well."""

    @property
    def log_weight(self) -> NDArray[np.float64]:
        """(P,) log p(z_t | m, x_{t-1}, u_t), likewise."""
        return np.asarray(np.logaddexp.reduce(self.log_mass, axis=1))

    def sample(self, random: np.random.Generator) -> NDArray[np.float64]:
        """x_t (P, 3), one from each particle's mixture.

        Modes are drawn by one comb over all particles, so that they get their shares.
        """
        count = np.arange(len(self.mean))
        noise = random.standard_normal((len(count), 3))
        comb = (random.permutation(len(count)) + random.random()) / len(count)
        mode = np.sum(np.cumsum(self.chosen, axis=1)[:, :-1] < comb[:, None], axis=1)
        root = np.linalg.cholesky(self.covariance[count, mode])
        x = self.mean[count, mode] + np.einsum("pij,pj->pi", root, noise)
        x[:, 2] = wrap_angle(x[:, 2])
        return np.asarray(x)


def improved_proposal(
    x: NDArray[np.float64], motions: Sequence[Motion], scans: Sequence[Beams], m: TileMaps,
    sigma: float,
) -> Proposal:  # fmt: skip
    """Where particles at `x` (P, 3) go after the first of the motions, each of which ended with the
    scan of the same place in the row; those after the first decide between modes. End points lie
    `sigma` m about surfaces.
    """
    mean, covariance, log_mass = _modes(x, motions[0], scans[0], m, sigma)
    log_chosen = log_mass
    if log_mass.shape[1] > 1:
        modes = np.moveaxis(mean, 1, 0)
        ahead = [_log_evidence(mode, motions[1:], scans[1:], m, sigma) for mode in modes]
        log_chosen = log_mass + np.stack(ahead, axis=1)
    chosen = np.exp(log_chosen - np.logaddexp.reduce(log_chosen, axis=1)[:, None])
    return Proposal(mean, covariance, log_mass, chosen)


def _log_evidence(
    x: NDArray[np.float64], motions: Sequence[Motion], scans: Sequence[Beams], m: TileMaps,
    sigma: float,
) -> NDArray[np.float64]:  # fmt: skip
    """(P,) log p(scans | m, x, motions) of particles that go on from `x` (P, 3)."""
    if not motions:
        return np.zeros(len(x))
    mean, _, log_mass = _modes(x, motions[0], scans[0], m, sigma)
    modes = np.moveaxis(mean, 1, 0)
    after = [_log_evidence(mode, motions[1:], scans[1:], m, sigma) for mode in modes]
    return np.asarray(np.logaddexp.reduce(log_mass + np.stack(after, axis=1), axis=1))


def _modes(
    x: NDArray[np.float64], motion: Motion, z: Beams, m: TileMaps, sigma: float
) -> tuple[NDArray[np.float64], ...]:
    """The Gaussians of a motion, after the scan: mean, covariance, log mass, as of `Proposal`."""
    modes = zip(motion.u, motion.covariance, strict=True)
    found = [_mode(x, u, covariance, z, m, sigma) for u, covariance in modes]
    mean, covariance, log_mass = (np.stack(some, axis=1) for some in zip(*found, strict=True))
    return mean, covariance, log_mass + np.log(motion.probability)


def _candidates(covariance: NDArray[np.float64]) -> NDArray[np.float64]:
    """Offsets (S, 3) from a predicted pose, a basin apart, all over the motion's noise."""
    sigma = np.sqrt(covariance.diagonal())
    count = np.minimum(_SIGMAS * sigma / _BASIN, _STEPS).astype(np.int64)
    axes = [np.linspace(-_SIGMAS, _SIGMAS, 2 * n + 1) if n else np.zeros(1) for n in count]
    grid = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 3)
    near = np.sum(grid**2, axis=1) <= _SIGMAS**2 * (1.0 + 1e-9)
    return np.ascontiguousarray(grid[near] * sigma)


def _mode(
    x: NDArray[np.float64],
    u: NDArray[np.float64],
    u_covariance: NDArray[np.float64],
    z: Beams,
    m: TileMaps,
    sigma: float,
) -> tuple[NDArray[np.float64], ...]:
    """One Gaussian of the motion, after the scan: mean, covariance, log mass."""
    count = len(x)
    predicted = compose_planar(x, u)
    mean, information, fits = np.zeros((count, 3)), np.zeros((count, 3, 3)), np.zeros(count)
    turns = planar_to_matrix(predicted)[:, :3, :3]
    prior = transported(turns, np.linalg.inv(u_covariance))
    offsets = _candidates(u_covariance)

    def match(first: int, last: int) -> None:
        matching.match(
            m.surfaces, first, last, z, predicted, prior, offsets, MAX_DISTANCES, sigma,
            mean, information, fits,
        )  # fmt: skip

    run_in_chunks(match, count, m.threads)
    covariance = np.asarray(np.linalg.inv(information), np.float64)
    # Laplace: the integral of exp(-cost) is exp(-minimum) times the root of |2 pi Sigma|.
    volume = 0.5 * (np.linalg.slogdet(covariance)[1] - np.linalg.slogdet(u_covariance)[1])
    return mean, covariance, fits + volume
