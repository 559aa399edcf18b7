"""The scans of the last metres, and the motion between them: what every place must explain."""

from __future__ import annotations

from collections import deque

import numpy as np
from numpy.typing import NDArray

from mapmyworld.config import Config
from mapmyworld.geometry.planar import between_planar, transform_points_planar
from mapmyworld.localisation.observation import Moment
from mapmyworld.registration.place_evidence import Place
from mapmyworld.registration.scan_search import Submap

Array = NDArray[np.float64]
_SCANS = 16  # of which a submap is made, about
_METRES_PER_RADIAN = 0.2  # of path that a rotation counts for


class RecentScans:
    """A submap that goes with the robot."""

    def __init__(self, config: Config) -> None:
        self._length = 2.0 * config.places.laser_submap
        self._kept: deque[tuple[float, Moment]] = deque()
        self.path = 0.0
        """Metres driven since it was begun."""

    def forget(self) -> None:
        """Begins anew: what was seen before lies nobody knows where."""
        self._kept.clear()
        self.path = 0.0

    def add(self, moment: Moment) -> None:
        """One more scan, after a motion."""
        self.path += float(np.hypot(*moment.step[:2])) + _METRES_PER_RADIAN * abs(moment.step[2])
        if moment.is_blind:
            return
        if not self._kept or self.path - self._kept[-1][0] >= self._length / _SCANS:
            self._kept.append((self.path, moment))
        while self._kept[0][0] < self.path - self._length:
            self._kept.popleft()

    def place(self, now: Moment) -> Place:
        """What was seen, as from where the robot is."""
        moments = [moment for _, moment in self._kept if moment is not now] + [now]
        points, origins = [], []
        for moment in moments:
            pose = between_planar(now.tracked, moment.tracked)
            rows = moment.scan.rows[:, :2].astype(np.float64)
            points.append(transform_points_planar(pose, rows))
            origins.append(transform_points_planar(pose, moment.scan.origin[None])[0])
        bounds = np.concatenate([[0], np.cumsum([len(some) for some in points])])
        submap = Submap(np.concatenate(points), np.array(origins), bounds.astype(np.int64))
        return Place.of(submap)
