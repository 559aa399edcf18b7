"""The search for a place that is not known: from nothing, or from where tracking was given up."""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass

import numpy as np

from mapmyworld.config import Config
from mapmyworld.geometry import Array
from mapmyworld.geometry.planar import between_planar, compose_planar
from mapmyworld.kernels.planar_algebra import invert3
from mapmyworld.localisation.known_place import KnownPlace
from mapmyworld.localisation.observation import SEARCHED, Moment, fit_at, match_at
from mapmyworld.places.laser_candidates import FIRST_WINDOW
from mapmyworld.places.node_drift import SIGMAS
from mapmyworld.places.refuted_odometry import FAULT_ODDS
from mapmyworld.registration.place_evidence import Agreement, Place, needed_evidence
from mapmyworld.registration.scan_matching import COARSE, Match, scan_set
from mapmyworld.registration.scan_search import APART, are_one
from mapmyworld.registration.submaps import MARGIN, NATS, Submap

Sighting = tuple[Array, Array]
"""A pose (3,) in the map, and the one (3,) that was tracked there."""


def _agree(before: Sighting | None, now: Sighting | None) -> bool:
    """Whether the motion since one sighting leads to the other one."""
    if before is None or now is None:
        return False
    moved = between_planar(before[1], now[1])
    return are_one(compose_planar(before[0], moved), now[0], APART)


@dataclass(frozen=True, slots=True, eq=False)
class Discovery:
    """A place that was recognised."""

    match: Match
    fit: Agreement
    supported: bool
    """Whether continuous motion from where the robot was known to be leads there as well."""


class GlobalLocalisation:
    """Looks for what was seen in the last metres, until the map explains it in one place only."""

    def __init__(self, place: KnownPlace, config: Config) -> None:
        self._place, self._config = place, config
        self._recent = RecentScans(config)
        self._is_due, self._tries = True, 0
        self._reckoned: Array | None = None
        self._covariance = np.zeros((3, 3))  # of the reckoned pose, in the robot's frame
        self._by_image: Sighting | None = None
        self._by_scans: Sighting | None = None

    def follow(self, moment: Moment) -> None:
        """One more moment, whether the place is known or not."""
        if moment.motion_lost:
            self._recent.forget()
            self._reckoned = None
        self._is_due |= self._recent.add(moment)
        if self._reckoned is not None:
            self._reckoned, self._covariance = moment.moved(self._reckoned, self._covariance)

    def begin(self, moment: Moment, reckoned: Array | None) -> None:
        """The place is lost; `reckoned` (3,) is where the robot was known to be, if anywhere.

        What was seen before speaks for that pose however far the robot was carried since: it is
        forgotten then, and so is what lies beyond a doubtful motion. A recognition that nothing
        confirmed leaves the pose as it was reckoned before.
        """
        if moment.motion_lost:
            self._reckoned = None
        elif reckoned is not None:
            self._reckoned, self._covariance = reckoned, np.zeros((3, 3))
        if reckoned is not None or moment.shaken:
            self._recent.forget()
            self._recent.add(moment)
        self._is_due, self._tries, self._by_image, self._by_scans = True, 0, None, None

    def add_match(self, moment: Moment, pose: Array) -> Discovery | None:
        """A pose (3,) by an image, where the scan and another image bear it out."""
        found = self._discovery(moment, pose, supported=False)
        before, self._by_image = self._by_image, None
        if found is not None:
            self._by_image = found.match.pose, moment.tracked
        return found if _agree(before, self._by_image) else None

    def look(self, moment: Moment) -> Discovery | None:
        """What one more moment shows, where it is time to try again."""
        if moment.is_blind or not self._is_due:
            return None
        self._is_due, self._tries = False, self._tries + 1
        place = self._recent.place(moment)
        near = self._near_reckoned(place)
        pose = self._elsewhere(place, moment) if near is None else near
        return None if pose is None else self._discovery(moment, pose, supported=near is not None)

    @property
    def path(self) -> float:
        """Metres along which scans were kept."""
        return self._recent.path

    def is_elsewhere(self, moment: Moment, pose: Array) -> bool | None:
        """Whether the last metres lie elsewhere in the map, and not at this pose (3,).

        None where they might as well.
        """
        return self._place.whole.is_elsewhere(self._recent.place(moment), pose)

    def _near_reckoned(self, place: Place) -> Array | None:
        """Where continuous motion leads, if the map goes with that."""
        if self._reckoned is None:
            return None
        x, y, yaw = np.diag(self._covariance)
        metres = min(APART[0] + SIGMAS * float(np.sqrt(x + y)), FIRST_WINDOW)
        window = metres, min(APART[1] + SIGMAS * float(np.sqrt(yaw)), np.pi)
        pose, _ = self._place.whole.best_about(place, self._reckoned, *window)
        said = self._place.whole.judge(place, pose)
        return pose if said.log_odds >= NATS * needed_evidence(*window) else None

    def _elsewhere(self, place: Place, moment: Moment) -> Array | None:
        """The one pose that explains the place, where motions that led on do not lead.

        Then two places in a row have to show it: a room that the map lacks may look like another.
        """
        found = self._anywhere(place)
        before, self._by_scans = self._by_scans, None
        if found is None or self._reckoned is None:
            return found
        self._by_scans = found, moment.tracked
        return found if _agree(before, self._by_scans) else None

    def _anywhere(self, place: Place) -> Array | None:
        """The one pose at which the map explains the place; None where that is open.

        Where motions led on, another place than theirs takes a fault that nothing indicated.
        """
        whole = self._place.whole
        pose, needed = whole.find(place), whole.needed_odds(self._tries)
        needed += 0.0 if self._reckoned is None else FAULT_ODDS
        if pose is None or whole.judge(place, pose).log_odds < needed:
            return None
        return None if whole.is_elsewhere(place, pose) is not False else pose

    def _discovery(self, moment: Moment, guess: Array, *, supported: bool) -> Discovery | None:
        """The match from a guess, where it stays near and the map does not contradict the scan."""
        match = match_at(self._place, moment, guess, COARSE, self._config, invert3(SEARCHED))
        off = np.abs(between_planar(guess, match.pose))
        if np.hypot(off[0], off[1]) >= APART[0] or off[2] >= APART[1]:
            return None
        fit = fit_at(self._place, moment, match.pose)
        return Discovery(match, fit, supported) if fit.evidence >= MARGIN else None


class RecentScans:
    """A submap that goes with the robot."""

    def __init__(self, config: Config) -> None:
        self._spacing = config.localisation.spacing
        scans = 2.0 * config.places.laser_submap / self._spacing
        self._kept: deque[Moment] = deque(maxlen=int(np.ceil(scans)))
        self.path = 0.0
        """Metres from one kept scan to the next, in all; a rotation counts as far as a spacing."""

    def forget(self) -> None:
        """Begins anew: what was seen before lies nobody knows where."""
        self._kept.clear()

    def add(self, moment: Moment) -> bool:
        """One more scan, after a motion; whether it is kept, as one from elsewhere."""
        if moment.is_blind:
            return False
        if self._kept:
            moved = between_planar(self._kept[-1].tracked, moment.tracked)
            if np.hypot(*moved[:2]) < self._spacing and abs(moved[2]) < APART[1]:
                return False
        self._kept.append(moment)
        self.path += self._spacing
        return True

    def place(self, now: Moment) -> Place:
        """What was seen, as from where the robot is."""
        moments = [moment for moment in self._kept if moment is not now] + [now]
        poses = between_planar(now.tracked, np.stack([moment.tracked for moment in moments]))
        return Place.of(Submap.of(scan_set([moment.scan for moment in moments]), poses))
