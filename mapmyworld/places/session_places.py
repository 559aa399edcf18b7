"""What a session saw, place by place, and whether another one saw the same building.

Another building of the same style may share a corner or two. So it is asked whether places agree as
often as the session does with itself, which each log shows.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy.special import betaln

from mapmyworld.config import Config
from mapmyworld.geometry import Array, Index
from mapmyworld.places.laser_candidates import SLACK
from mapmyworld.places.laser_nodes import LaserNodes, spaced
from mapmyworld.places.laser_submaps import place_around
from mapmyworld.places.whole_map import SETTLED, WholeMap, map_of_scans
from mapmyworld.registration.place_evidence import Agreement, Place
from mapmyworld.registration.submaps import Submap

_CHANGED = 0.1  # share of places that no longer look as they did, or that drift moved away
_MOVED = 0.03  # share of surfaces in the others that stand elsewhere by another session
_PLACE = 20.0  # points that would make their share differ as it does from place to place


@dataclass(frozen=True, eq=False)
class SessionPlaces:
    """What a session saw."""

    nodes: LaserNodes
    rows: Index
    """(R,) its nodes, ascending."""
    config: Config

    @cached_property
    def whole(self) -> WholeMap:
        """In the frame of the nodes' poses."""
        spacing = 0.5 * self.config.places.laser_spacing
        rows = self.rows[spaced(self.nodes.path[self.rows], spacing)]
        return map_of_scans(Submap.of(self.nodes.scans.some(rows), self.nodes.poses[rows]))

    @cached_property
    def places(self) -> dict[int, Place]:
        """Node -> what was seen around it, about every half of a submap."""
        return {k: place_around(self.nodes, k, self.config) for k in self.spots}

    def is_of(self, reports: Iterable[Agreement]) -> float:
        """Nats by which another session's places are of this building, and not of another one.

        Here they agree as often as this session's own, but for what was moved, each by a share that
        is beta-distributed; in another building of the same style any share is as likely.
        """
        known = [(one.hits, one.contradictions) for one in reports if one.log_odds]
        hits, misses = np.reshape(known, (-1, 2)).T
        share = (1.0 - _MOVED) * self._agreement
        here, any_share = (_PLACE * share, _PLACE * (1.0 - share)), (1.0, 1.0)
        same, other = (betaln(hits + a, misses + b) - betaln(a, b) for a, b in (here, any_share))
        return some_changed(same - other)

    @cached_property
    def _agreement(self) -> float:
        """Share of its map's points that its own places see where they are."""
        own = [self.whole.judge(p, self.nodes.poses[k]).back for k, p in self.places.items()]
        known = np.concatenate([np.zeros(0), *own])
        hits, misses = np.count_nonzero(known > 0), np.count_nonzero(known < 0)
        return (hits + 1.0) / (hits + misses + 2.0)

    @property
    def spots(self) -> list[int]:
        """The nodes of those places."""
        return self._apart(self.rows[self.nodes.sees[self.rows]].tolist(), 1.0)

    @cached_property
    def sought(self) -> list[int]:
        """The nodes of those places that are looked for: about every whole submap."""
        return self._apart(self.spots, 2.0)

    def windows(self, about: Array) -> dict[int, tuple[float, float]]:
        """Metres and radians by which each of the places may be off, as seen from a pose (3,)."""
        spots = np.array(list(self.places), np.int64)
        drift = self.nodes.drift.reach(np.full(len(spots), self.nearest(about)), spots)
        metres, radians = np.minimum(SETTLED + drift, SLACK).T.tolist()
        return dict(zip(self.places, zip(metres, radians, strict=True), strict=True))

    def nearest(self, pose: Array) -> int:
        """Row of its node nearest to a pose (3,)."""
        off = self.nodes.poses[self.rows, :2] - pose[:2]
        return int(self.rows[np.argmin(np.hypot(off[:, 0], off[:, 1]))])

    def _apart(self, among: list[int], size: float) -> list[int]:
        """Those of these nodes that lie so many halves of a submap from all chosen before."""
        poses, apart = self.nodes.poses, size * self.config.places.laser_submap
        chosen: list[int] = []
        for k in among:
            off = poses[chosen, :2] - poses[k, :2]
            if not (np.hypot(off[:, 0], off[:, 1]) < apart).any():
                chosen.append(k)
        return chosen


def some_changed(odds: Array) -> float:
    """The sum of `odds` (P,) in nats. A place may have changed, or drifted: none contradicts by
    more than the share of such.
    """
    return float(np.logaddexp(np.log(1.0 - _CHANGED) + odds, np.log(_CHANGED)).sum())
