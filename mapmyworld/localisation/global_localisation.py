"""Global localisation: from nothing, or from where tracking was given up."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mapmyworld.config import Config
from mapmyworld.geometry.planar import between_planar, compose_planar
from mapmyworld.kernels.scan_alignment import invert3
from mapmyworld.localisation.known_place import Fit, KnownPlace
from mapmyworld.localisation.monte_carlo import MonteCarlo
from mapmyworld.localisation.observation import Moment, fit_at, is_convincing, match_at
from mapmyworld.localisation.past import Past
from mapmyworld.localisation.search import distinct_places, search_map
from mapmyworld.registration.scan_matching import COARSE, Match

Array = NDArray[np.float64]
_PATIENCE = 3.0  # m of motion after which a search that led nowhere begins anew
_NO_LEAP = np.array([0.5, 0.35])  # m and rad from a belief within which a match must end
_ASTRAY = 0.05  # m per m of continuous motion by which dead reckoning may be off
_SLACK = 1.0  # m by which it may be off anyway
_STREAK = 10  # weighings in a row that must find the same convincing place
_STREAK_AGAINST = 25  # the same, for a place where continuous motion cannot have led
_ALTERNATIVES = 12  # other places that a decision is compared with
_DECISIVE = 4.6  # nats by which the scans must favour a place: 99 to 1
_RECKONED = np.diag([0.1, 0.1, 0.05]) ** 2  # m^2, m^2, rad^2 of dead reckoning that fits again


@dataclass(frozen=True, slots=True, eq=False)
class Discovery:
    """A place that was recognised."""

    match: Match
    covariance: Array
    """(3, 3) of the guess that the match began with."""
    fit: Fit
    supported: bool
    """Whether continuous motion from where the robot was known to be leads there as well."""


class GlobalLocalisation:
    """Weighs all places of the map while the robot moves, until one is left."""

    def __init__(self, place: KnownPlace, config: Config) -> None:
        self._place, self._config = place, config
        self._particles = MonteCarlo(place, config)
        self._pending = np.zeros(3)
        self._streak, self._searched = 0, 0.0
        self._reckoned: Array | None = None
        self._distance = 0.0
        self._last_match: Array | None = None
        self._since_match = np.zeros(3)
        self._past = Past()

    def begin(self, moment: Moment, reckoned: Array) -> None:
        """Starts at a moment; `reckoned` (3,) is where the robot was thought to be."""
        self._reckoned, self._distance = None if moment.motion_lost else reckoned, 0.0
        self._past.forget()
        self._restart(moment)

    def begin_anywhere(self, moment: Moment) -> None:
        """Starts at a moment, with no idea of where that is."""
        self._reckoned = None
        self._past.forget()
        self._restart(moment)

    def resume(self, moment: Moment) -> None:
        """Goes on: what had been found was wrong."""
        self._restart(moment)

    def _restart(self, moment: Moment) -> None:
        self._particles.begin(moment.points)
        self._streak, self._searched = 0, 0.0
        self._pending = np.zeros(3)
        self._last_match = None

    def add_match(self, moment: Moment, image_pose: Array) -> Discovery | None:
        """What an image indicates it, pose (3,), where the scan and another image bear it out."""
        found = self._discovery(moment, image_pose, _RECKONED)
        before, self._last_match = self._last_match, None if found is None else found.match.pose
        if found is None or before is None or self._contradicts_motion(found.match.pose):
            return None
        apart = between_planar(compose_planar(before, self._since_match), found.match.pose)
        self._since_match = np.zeros(3)
        return found if np.hypot(apart[0], apart[1]) < _NO_LEAP[0] else None

    def look(self, moment: Moment) -> Discovery | None:
        """What one more moment indicates it."""
        self.reckon(moment)
        if moment.motion_lost:
            self._past.forget()
        self._since_match = compose_planar(self._since_match, moment.step)
        self._pending = compose_planar(self._pending, moment.step)
        if moment.is_blind:
            return None
        if self._particles.is_empty:
            self._restart(moment)
        settings = self._config.localisation
        distance = float(np.hypot(*self._pending[:2]))
        if distance < settings.step_distance and abs(self._pending[2]) < settings.step_angle:
            return None
        self._particles.step(self._pending, moment.points)
        self._past.add(self._pending, moment.points)
        self._pending = np.zeros(3)
        self._searched += distance
        return self._picked_up(moment) or self._decided(moment)

    def reckon(self, moment: Moment) -> None:
        """Where continuous motion leads from where the robot was known to be."""
        if self._reckoned is None:
            return
        self._reckoned = compose_planar(self._reckoned, moment.step)
        self._distance += float(np.hypot(*moment.step[:2]))
        if moment.motion_lost:
            self._reckoned = None

    def _picked_up(self, moment: Moment) -> Discovery | None:
        """Dead reckoning that goes with the map again."""
        if self._reckoned is None:
            return None
        return self._discovery(moment, self._reckoned, _RECKONED)

    def _decided(self, moment: Moment) -> Discovery | None:
        belief = self._particles.belief()
        found = None
        if belief.share >= self._config.localisation.certainty:
            found = self._discovery(moment, belief.pose, belief.covariance)
        self._streak = 0 if found is None else self._streak + 1
        if found is None:
            if self._searched > _PATIENCE:
                self._restart(moment)
            return None
        against = self._contradicts_motion(found.match.pose)
        if self._streak < (_STREAK_AGAINST if against else _STREAK):
            return None
        if self._is_ambiguous(moment, found.match.pose):
            self._streak = 0
            return None
        return found

    def _is_ambiguous(self, moment: Moment, pose: Array) -> bool:
        """Whether the scans since the search began go about as well with another place.

        The particles cannot: of two places that look the same, resampling drops one in time.
        """
        found = search_map(self._place, moment.points, self._config)
        others = distinct_places(found, pose, _ALTERNATIVES)
        matched = [match_at(self._place, moment, r, COARSE, self._config).pose for r in others]
        if not matched:
            return False
        evidence = self._past.evidence(np.stack([pose, *matched]), self._particles.log_likelihood)
        apart = np.abs(between_planar(pose, np.stack(matched)))
        elsewhere = (np.hypot(apart[:, 0], apart[:, 1]) > _NO_LEAP[0]) | (apart[:, 2] > _NO_LEAP[1])
        return bool(np.any(elsewhere & (evidence[1:] > evidence[0] - _DECISIVE)))

    def _discovery(self, moment: Moment, guess: Array, covariance: Array) -> Discovery | None:
        """The match from a guess, where it stays near and convinces."""
        match = match_at(self._place, moment, guess, COARSE, self._config, invert3(covariance))
        off = np.abs(between_planar(guess, match.pose))
        fit = fit_at(self._place, moment, match.pose, self._config)
        stays = np.hypot(off[0], off[1]) < _NO_LEAP[0] and off[2] < _NO_LEAP[1]
        if not stays or not is_convincing(fit, self._config):
            return None
        supported = self._reckoned is not None and not self._contradicts_motion(match.pose)
        return Discovery(match, covariance, fit, supported)

    def _contradicts_motion(self, pose: Array) -> bool:
        """Whether the robot cannot have come here from where it was known to be."""
        if self._reckoned is None:
            return False
        apart = float(np.hypot(*(pose - self._reckoned)[:2]))
        return apart > _SLACK + _ASTRAY * self._distance
