"""The Rao-Blackwellised particle filter: a path and, given the path, a map a particle."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.special import softmax

from mapmyworld.config import ParticlesConfig
from mapmyworld.geometry.planar import wrap_angle
from mapmyworld.odometry.sweep_noise import SIGMAS_PER_MEDIAN
from mapmyworld.particles.kernels.likelihood import surface_distances
from mapmyworld.particles.kernels.surface_tiles import Beams
from mapmyworld.particles.motions import Motion
from mapmyworld.particles.proposal import MAX_DISTANCES, Proposal, improved_proposal
from mapmyworld.particles.tiles import TileMaps

_FIRST = 0.04  # m, end points about surfaces before the first were measured
_WIDTH = 3.0  # times what was measured: beams that err together count as one in nine
_QUANTILE = 2.33  # of the normal distribution: 99 %
_FINEST = 0.03  # cells, how far a cell's mean and normal hold a line at best
_BIN = np.array([0.1, 0.1, np.radians(2.0)])  # m, m, rad: poses in one bin count as the same


@dataclass(frozen=True, slots=True, eq=False)
class Generation:
    """What one update left behind."""

    x: NDArray[np.float64]
    """(P, 3) poses drawn."""
    ancestors: NDArray[np.int64]
    """(Q,) which of them the next update starts from."""
    covariance: NDArray[np.float64]
    """(3, 3) of the weighted particles and of their Gaussians, about the mean, in its own frame."""
    effective: float
    """Effective sample size before resampling."""
    resampled: bool


class ParticleFilter:
    """Particles at poses x with weights w and maps m; `step` is one line of the algorithm each."""

    def __init__(self, config: ParticlesConfig, threads: int, seed: int) -> None:
        self.config, self.seed = config, seed
        self.m = TileMaps(config.count, config.resolution, threads)
        self.x = np.zeros((config.count, 3))
        """(P, 3) poses."""
        self.log_w = np.zeros(config.count)
        """(P,) logarithms of weights."""
        self.generations: list[Generation] = []
        self.surface_sigma = _FIRST
        """m, standard deviation of end points about surfaces in the likelihood."""
        self._medians: list[float] = []  # m, of each scan's distances from surfaces

    def step(self, motions: Sequence[Motion], scans: Sequence[Beams]) -> None:
        """Moves, which ended with the first of the scans: propose, weigh, map, resample.

        There are no motions at the start of the log; else scan k ended motion k, and those after
        the first are looked at ahead.
        """
        random = self._random()
        covariance = np.zeros((3, 3))
        if motions:
            proposal = improved_proposal(self.x, motions, scans, self.m, self.surface_sigma)
            self.x = proposal.sample(random)
            self.log_w = self.log_w + proposal.log_weight / max(len(scans[0].points), 1)
            self._measure_noise(proposal, scans[0])
            covariance = _mixture_covariance(proposal, softmax(self.log_w))
        self.m.insert(scans[0], self.x)
        self._select(covariance, float(random.random()))

    def best_path(self) -> NDArray[np.float64]:
        """(K, 3) the path of the particle with the greatest weight, by its ancestors."""
        index = int(np.argmax(self.log_w))
        path = np.zeros((len(self.generations), 3))
        for k in range(len(path) - 1, -1, -1):
            index = int(self.generations[k].ancestors[index])
            path[k] = self.generations[k].x[index]
        return path

    def _measure_noise(self, proposal: Proposal, scan: Beams) -> None:
        """Learns how far end points lie from surfaces, where the heaviest particle has the scan."""
        best = int(np.argmax(self.log_w))
        pose = proposal.mean[best, int(np.argmax(proposal.chosen[best]))]
        distances = surface_distances(self.m.surfaces, best, scan, pose, MAX_DISTANCES[-1])
        if len(distances):
            self._medians.append(float(np.median(distances)))
            measured = SIGMAS_PER_MEDIAN * float(np.median(self._medians))
            self.surface_sigma = _WIDTH * max(measured, _FINEST * self.config.resolution)

    def _random(self) -> np.random.Generator:
        """Numbers that depend on the seed and on how many updates there were, on nothing else."""
        counter = len(self.generations) << 64
        return np.random.Generator(np.random.Philox(key=self.seed, counter=counter))

    def _select(self, covariance: NDArray[np.float64], r: float) -> None:
        """Resamples when few particles carry the weight; records what happened."""
        w = softmax(self.log_w)
        effective = effective_sample_size(w)
        resampled = effective < self.config.resample_below * len(w)
        ancestors, x = np.arange(len(w)), self.x
        if resampled:
            ancestors = low_variance_sampler(w, self._wanted(w), r)
            self.m.resample(ancestors)
            self.x, self.log_w = x[ancestors], np.zeros(len(ancestors))
        self.generations.append(Generation(x, ancestors, covariance, effective, resampled))

    def _wanted(self, w: NDArray[np.float64]) -> int:
        """How many particles describe the present spread of poses (Fox 2003)."""
        heavy = self.x[w > 0.1 / len(w)]
        bins = len(np.unique(np.floor(heavy / _BIN), axis=0))
        wanted = kld_sample_size(bins, self.config.kld_error)
        return int(
            np.clip(wanted, min(self.config.count_min, self.config.count), self.config.count)
        )


def _mixture_covariance(proposal: Proposal, w: NDArray[np.float64]) -> NDArray[np.float64]:
    """Covariance (3, 3) of a weighted sum of Gaussians, in the frame of the heaviest one.

    By the law of total covariance: the mean of the covariances plus the covariance of the means.
    """
    weights = w[:, None] * proposal.chosen
    mean, each = proposal.mean.reshape(-1, 3), proposal.covariance.reshape(-1, 3, 3)
    w = weights.ravel()
    about = mean[int(np.argmax(w))]
    deviation = mean - about
    deviation[:, 2] = wrap_angle(deviation[:, 2])
    deviation -= w @ deviation
    total = np.einsum("p,pij->ij", w, each)
    total += np.einsum("p,pi,pj->ij", w, deviation, deviation)
    cos, sin = np.cos(about[2]), np.sin(about[2])
    turn = np.array([[cos, sin, 0.0], [-sin, cos, 0.0], [0.0, 0.0, 1.0]])
    return np.asarray(turn @ total @ turn.T)


def effective_sample_size(w: NDArray[np.float64]) -> float:
    """1 / sum of w^2, w (P,): P when all are equal, 1 when one particle has all the weight."""
    return float(1.0 / np.sum(w * w))


def low_variance_sampler(w: NDArray[np.float64], count: int, r: float) -> NDArray[np.int64]:
    """(C,) ancestors of the next particles by weights w (P,); C is `count`.

    Thrun, Burgard, Fox 2005, table 4.4: a comb of `count` equal steps over the cumulated weights,
    so that a particle of weight w is drawn count * w times, rounded up or down. `r` in [0, 1) is
    the one random number it takes.
    """
    comb = (np.arange(count) + r) / count
    cumulated = np.cumsum(w)
    return np.minimum(np.searchsorted(cumulated / cumulated[-1], comb, "right"), len(w) - 1)


def kld_sample_size(bins: int, error: float) -> int:
    """Particles after which the sampled distribution over `bins` bins is `error` from the true one.

    In Kullback-Leibler divergence, with a certainty of 99 % (Fox, "Adapting the sample size in
    particle filters through KLD-sampling", 2003, by the Wilson-Hilferty approximation of the
    chi-squared distribution).
    """
    if bins < 2:
        return 1
    a = 2.0 / (9.0 * (bins - 1))
    return math.ceil((bins - 1) / (2.0 * error) * (1.0 - a + math.sqrt(a) * _QUANTILE) ** 3)
