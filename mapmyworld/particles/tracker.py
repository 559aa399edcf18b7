"""Local motion by scan matching, once for all particles: what the filter is given as u.

Odometry only proposes where to start: the scan decides, against a map of the last metres. The
prior is heavy-tailed, so that odometry which contradicts the scan (a wheel slips, a driver counts
forwards while the robot reverses) is outvoted instead of averaged in.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from mapmyworld.config.particles_settings import ParticlesConfig
from mapmyworld.geometry.planar import between_planar, compose_planar
from mapmyworld.particles import kernels
from mapmyworld.particles.kernels import Beams
from mapmyworld.particles.threads import Workers
from mapmyworld.particles.tiles import TileMaps

_MAX_DISTANCES = np.array([6, 5, 4, 3, 2, 2, 2, 2, 2, 2, 2, 2], np.int64)
_ROBUST = 2.0  # standard deviations after which odometry counts less
_GOOD = 0.7  # matched share from which the first guess is taken
_FAR = 4.0  # squared deviation from odometry from which other guesses are tried
_POOR = 0.5  # matched share below which the search widens
_REVERSED = np.array([-1.0, -1.0, 1.0])
_WIDER = np.array(
    [[x, y, a] for x in (-0.15, 0, 0.15) for y in (-0.1, 0, 0.1) for a in (-0.1, 0.1)]
)
_SUBMAP_STEPS = 60  # filter steps after which the older of the two local maps is dropped


class LocalTracker:
    """Pose of the robot in a frame of its own that drifts, but only slowly."""

    def __init__(self, config: ParticlesConfig, workers: Workers) -> None:
        self._config = config
        self._maps = TileMaps(2, config.resolution, workers)
        self._steps = 0
        self._older = 0
        self._last_step = np.zeros(3)
        self.pose = np.zeros(3)

    def track(self, odometry: NDArray[np.float64] | None, beams: Beams) -> NDArray[np.float64]:
        """The pose (3,) after a motion that odometry puts at `odometry` (3,), or nowhere."""
        if self._steps == 0:
            return self.pose
        motion = self._last_step if odometry is None else odometry
        guesses = np.array([motion, self._last_step, np.zeros(3), motion * _REVERSED])
        found = self._match(beams, guesses[:1], recorded=odometry is not None)
        if found[1][0] < _GOOD or found[1][2] > _FAR:
            found = self._match(beams, guesses, recorded=odometry is not None)
        if found[1][0] < _POOR:
            wider = np.concatenate([guesses, motion + _WIDER, _WIDER])
            found = self._match(beams, wider, recorded=odometry is not None)
        before, self.pose = self.pose, found[0]
        self._last_step = between_planar(before, self.pose)
        return self.pose

    def _match(
        self, beams: Beams, guesses: NDArray[np.float64], *, recorded: bool
    ) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """The best pose (3,) from these guesses of the motion, the first being the prior."""
        starts = compose_planar(self.pose, guesses)[None]
        pose, information, quality = np.zeros((1, 3)), np.zeros((1, 3, 3)), np.zeros((1, 3))
        maps = self._maps.surfaces
        maps = maps._replace(tables=maps.tables[self._older : self._older + 1])
        kernels.match(
            maps,
            0,
            1,
            beams,
            starts,
            self._prior(guesses[0], recorded),
            _ROBUST,
            _MAX_DISTANCES,
            self._config.sigma,
            self._scale(beams),
            pose,
            information,
            quality,
        )
        return pose[0], quality[0]

    def remember(self, beams: Beams) -> None:
        """Adds the scan at the current pose to the local maps."""
        if self._steps and self._steps % _SUBMAP_STEPS == 0:
            self._maps.clear(self._older)
            self._older = 1 - self._older
        self._maps.insert(beams, np.stack([self.pose, self.pose]))
        self._steps += 1

    def _scale(self, beams: Beams) -> float:
        return min(1.0, self._config.beams_effective / max(len(beams.points), 1))

    def _prior(self, motion: NDArray[np.float64], recorded: bool) -> NDArray[np.float64]:
        distance, angle = float(np.hypot(*motion[:2])), abs(float(motion[2]))
        share, floor = self._config.odometry_sigma, self._config.odometry_floor
        if not recorded:
            share, floor = 1.0, 5.0 * floor
        sigma = np.array(
            [floor + share * distance, floor + share * distance, 0.5 * floor + share * angle]
        )
        return np.diag(1.0 / sigma**2)
