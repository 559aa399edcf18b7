"""The scans of the last metres, and the motion between them: what every place must explain."""

from __future__ import annotations

from collections import deque

import numpy as np

from mapmyworld.config import Config
from mapmyworld.geometry.planar import between_planar
from mapmyworld.localisation.observation import Moment
from mapmyworld.registration.place_evidence import Place
from mapmyworld.registration.scan_matching import scan_set
from mapmyworld.registration.scan_search import APART, Submap


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
