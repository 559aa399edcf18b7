"""Monte Carlo localisation: hypotheses all over the map, until one place is left.

Thrun, Burgard, Fox, "Probabilistic Robotics" (2005), table 8.2, with the number of particles by
KLD-sampling (Fox 2003). The first particles are no random ones but all places that fit the first
scan, and each moves by scan-matched motion.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mapmyworld.config import Config
from mapmyworld.geometry.planar import wrap_angle
from mapmyworld.kernels.map_search import field_scores
from mapmyworld.localisation.known_place import KnownPlace
from mapmyworld.localisation.search import search_map
from mapmyworld.parallel import run_in_chunks
from mapmyworld.particles.motion_model import MotionNoise, sample_motion_model
from mapmyworld.particles.resampling import (
    kld_sample_size,
    low_variance_sampler,
    normalised_weights,
)

Array = NDArray[np.float64]
_BIN = np.array([0.25, 0.25, np.radians(10.0)])  # m, m, rad: poses in one bin count as the same
_ERROR = 0.05  # Kullback-Leibler distance to the true belief
_NOISE = MotionNoise(0.05, 0.03, 0.05, 0.02)  # scan-matched motion errs little
_JITTER = np.array([0.03, 0.03, 0.02])  # m, m, rad between the descendants of one particle
_ONE_PLACE = np.array([0.5, 0.35])  # m and rad about the best particle that are one place


@dataclass(frozen=True, slots=True, eq=False)
class Belief:
    """The place that the particles favour."""

    pose: Array
    """(3,) mean of its particles."""
    covariance: Array
    """(3, 3) of its particles, in the frame of `pose`."""
    share: float
    """Of the weight, that lies there."""


class MonteCarlo:
    """Particles x with weights w in a known map m."""

    def __init__(self, place: KnownPlace, config: Config) -> None:
        self._place, self._config = place, config
        settings = config.localisation
        hit, chance = 0.9, 0.1
        spread = np.exp(-0.5 * (place.distance / settings.field_sigma) ** 2)
        self._field = np.log(hit * spread + chance).astype(np.float32)
        self._free = place.cells == 0
        self._outside = float(np.log(chance))
        self._steps = 0
        self.x = np.zeros((0, 3))
        self.log_w = np.zeros(0)

    def begin(self, points: Array) -> None:
        """Anew: particles wherever the map explains the points (N, 2) of a scan."""
        found = search_map(self._place, points, self._config)
        self.x = found.poses
        self.log_w = self.log_likelihood(self.x, points)

    def step(self, u: Array, points: Array) -> None:
        """Moves by u (3,), which ended with a scan of these points: lines 3 to 11 of table 8.2."""
        random = self._random()
        self._resample(random)
        self.x = sample_motion_model(u, self.x, _NOISE, random)
        self.x = self.x + random.normal(0.0, 1.0, self.x.shape) * _JITTER
        self.x[:, 2] = wrap_angle(self.x[:, 2])
        self.log_w = self.log_likelihood(self.x, points)

    @property
    def is_empty(self) -> bool:
        """Whether no scan has been looked for yet."""
        return len(self.x) == 0

    def belief(self) -> Belief:
        """The heaviest place; there must be particles."""
        w = normalised_weights(self.log_w)
        best = self.x[int(np.argmax(w))]
        off = self.x - best
        off[:, 2] = wrap_angle(off[:, 2])
        here = (np.hypot(off[:, 0], off[:, 1]) < _ONE_PLACE[0]) & (
            np.abs(off[:, 2]) < _ONE_PLACE[1]
        )
        share = float(w[here].sum())
        mean = (w[here] @ off[here]) / share
        centred = off[here] - mean
        c, s = np.cos(best[2]), np.sin(best[2])
        turn = np.array([[c, s, 0.0], [-s, c, 0.0], [0.0, 0.0, 1.0]])
        covariance = turn @ ((centred.T * w[here]) @ centred / share) @ turn.T
        return Belief(best + mean, covariance + np.diag(_JITTER**2), share)

    def log_likelihood(self, x: Array, points: Array) -> Array:
        """Logarithm (K,) of p(z | x, m) of poses (K, 3) by the likelihood field (table 6.3)."""
        settings, place = self._config.localisation, self._place
        scores = np.zeros(len(x))
        poses = np.ascontiguousarray(x)

        def work(first: int, last: int) -> None:
            field_scores(
                first, last, self._field, self._free, place.corner, place.resolution, points,
                poses, self._outside, scores,
            )  # fmt: skip

        run_in_chunks(work, len(poses), self._config.threads)
        return scores * min(settings.points_effective / max(len(points), 1), 1.0)

    def _resample(self, random: np.random.Generator) -> None:
        settings = self._config.localisation
        w = normalised_weights(self.log_w)
        heavy = self.x[w > 0.1 / len(w)]
        bins = len(np.unique(np.floor(heavy / _BIN), axis=0))
        wanted = int(
            np.clip(kld_sample_size(bins, _ERROR), settings.particles_min, settings.particles)
        )
        self.x = self.x[low_variance_sampler(w, wanted, float(random.random()))]

    def _random(self) -> np.random.Generator:
        """Numbers that depend on the seed and on how many steps there were, on nothing else."""
        self._steps += 1
        return np.random.Generator(np.random.Philox(key=self._config.seed, counter=self._steps))
