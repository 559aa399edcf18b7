"""Grid-based FastSLAM over a whole log."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from mapmyworld.config import Config
from mapmyworld.config.particles import ParticlesConfig
from mapmyworld.geometry import between_planar, compose_planar, wrap_angle
from mapmyworld.particles.kernels import Beams
from mapmyworld.particles.proposal import improved_proposal
from mapmyworld.particles.resampling import (
    effective_sample_size,
    low_variance_sampler,
    normalised_weights,
)
from mapmyworld.particles.threads import Workers
from mapmyworld.particles.tiles import TileMaps


@dataclass(slots=True)
class Filter:
    """Particles: a pose, a map and a weight each, and where they came from."""

    config: ParticlesConfig
    workers: Workers
    seed: int
    maps: TileMaps = field(init=False)
    x: NDArray[np.float64] = field(init=False)
    log_w: NDArray[np.float64] = field(init=False)
    poses: list[NDArray[np.float64]] = field(default_factory=list)
    ancestors: list[NDArray[np.int64]] = field(default_factory=list)
    covariances: list[NDArray[np.float64]] = field(default_factory=list)
    effective: list[float] = field(default_factory=list)
    resampled: list[bool] = field(default_factory=list)

    def __post_init__(self) -> None:
        self.maps = TileMaps(self.config.count, self.config.resolution, self.workers)
        self.x = np.zeros((self.config.count, 3))
        self.log_w = np.zeros(self.config.count)

    def step(self, u: NDArray[np.float64], z: Beams) -> None:
        """One update: propose, weigh, resample when weights differ much, map."""
        random = np.random.Generator(np.random.Philox(key=self.seed, counter=len(self.poses) << 64))
        ancestors = np.arange(len(self.x))
        resample = False
        spread = np.zeros((3, 3))
        if self.poses:
            proposal = improved_proposal(
                self.x,
                u,
                motion_covariance(u, self.config),
                z,
                self.maps,
                self.config,
                self.workers,
            )
            self.x = proposal.sample(random)
            self.log_w = self.log_w + proposal.log_weight
            self.log_w -= np.max(self.log_w)
            w = normalised_weights(self.log_w)
            self.effective.append(effective_sample_size(w))
            resample = self.effective[-1] < self.config.resample_below * len(w)
        self.maps.insert(z, self.x)
        self.poses.append(self.x)
        if resample:
            ancestors = low_variance_sampler(w, len(w), float(random.random()))
            self.x, self.log_w = self.x[ancestors], np.zeros(len(w))
            self.maps.resample(ancestors)
        self.ancestors.append(ancestors)
        self.resampled.append(resample)

    def paths(self) -> NDArray[np.float64]:
        """(P, K, 3) the path of each of the last particles, by their ancestors."""
        index = np.arange(len(self.x))
        out = np.zeros((len(self.x), len(self.poses), 3))
        for k in range(len(self.poses) - 1, -1, -1):
            index = self.ancestors[k][index]
            out[:, k] = self.poses[k][index]
        return out


def motion_covariance(u: NDArray[np.float64], config: ParticlesConfig) -> NDArray[np.float64]:
    """(3, 3) of scan-matched motion u, body frame."""
    distance, angle = float(np.hypot(*u[:2])), abs(float(u[2]))
    sigma_xy = 0.02 + config.drift_sigma * (distance + 0.1 * angle)
    sigma_yaw = 0.01 + config.drift_angle * (distance + angle)
    return np.diag([sigma_xy**2, sigma_xy**2, sigma_yaw**2])
