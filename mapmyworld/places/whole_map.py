"""All that was mapped, as one grid of evidence in which a place is looked for, however lost."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from mapmyworld.geometry import Array
from mapmyworld.geometry.planar import invert_planar, transform_points_planar
from mapmyworld.kernels.branch_and_bound import RESOLUTION
from mapmyworld.registration.likelihood_grid import BESIDE, LikelihoodGrid
from mapmyworld.registration.place_evidence import FORTH, Agreement, Place, chance, needed_evidence
from mapmyworld.registration.scan_search import (
    judged_points,
    search_about,
    search_elsewhere,
    search_everywhere,
)
from mapmyworld.registration.submaps import (
    MARGIN,
    NATS,
    Submap,
    evidence_grid,
    scored_points,
    spread_points,
)

SETTLED = 0.2, 0.03
"""Metres and radians by which a place may be off in a solved map, beside its drift."""


@dataclass(frozen=True, slots=True, eq=False)
class WholeMap:
    """Surfaces, free and unseen cells of a whole map, in its frame."""

    points: Array
    """(N, 2) of the surfaces, one to a cell."""
    grid: LikelihoodGrid

    @property
    def needed(self) -> float:
        """Points from which the best pose of a place, anywhere and in any heading, is no chance."""
        if len(self.points) == 0:
            return np.inf
        return needed_evidence(float(np.ptp(self.points, axis=0).max()) / 2.0, np.pi)

    def needed_odds(self, tries: int) -> float:
        """Nats from which the best of so many places that were looked for is no chance."""
        return self.needed * NATS + float(np.log(max(tries, 1)))

    def judge(self, place: Place, pose: Array) -> Agreement:
        """How the map and a place at a pose (3,) agree about each other's points."""
        back = invert_planar(pose)
        seen = transform_points_planar(back, self.points)
        low, high = place.grid.bounds
        near = scored_points(seen[((seen >= low) & (seen < high)).all(axis=1)])
        return Agreement(
            judged_points(place.submap.scored, place.grid, self.grid, pose),
            judged_points(transform_points_planar(pose, near), self.grid, place.grid, back),
            place.submap.scored,
        )

    def find(self, place: Place) -> Array | None:
        """The pose (3,) at which the map explains a place best; None where that may be chance."""
        if len(place.submap.points) == 0 or len(self.points) == 0:
            return None
        pose = search_everywhere(place.submap.scored, self.grid, FORTH * self.needed)
        return None if pose is None else self.best_about(place, pose, *SETTLED)[0]

    def find_about(self, place: Place, pose: Array, distance: float, angle: float) -> Array | None:
        """The same (3,) of poses in a window, m and rad to each side of this one (3,)."""
        if len(self.points) == 0 or distance > np.ptp(self.points, axis=0).max():
            return self.find(place)
        points, least = place.submap.scored, FORTH * self.needed
        found = search_about(points, self.grid, pose, distance, min(angle, np.pi), least)
        return None if found is None else self.best_about(place, found, *SETTLED)[0]

    def find_other(self, place: Place, pose: Array, least: float = 0.0) -> Array | None:
        """The best other pose (3,) than this one (3,) of a place, of more points than `least`."""
        least = max(least, FORTH * self.needed)
        other = search_elsewhere(place.submap.scored, self.grid, pose, least)
        return None if other is None else self.best_about(place, other, *SETTLED)[0]

    def is_elsewhere(self, place: Place, pose: Array) -> bool | None:
        """Whether the place rather lies at another pose than at this one (3,).

        None where both are about as likely.
        """
        here = self.judge(place, pose)
        other = self.find_other(place, pose, BESIDE * (float(here.forth.sum()) - MARGIN))
        if other is None:
            return False
        there = self.judge(place, other)
        if here.beyond(there) >= MARGIN:
            return False
        return True if there.beyond(here) >= MARGIN else None

    def best_about(
        self, place: Place, pose: Array, distance: float, angle: float
    ) -> tuple[Array, Agreement]:
        """The best pose (3,) in a window about one (3,), or that one where chance explains it."""
        here = self.judge(place, pose)
        if not here.forth.any() and not here.back.any():
            return pose, here
        least = float(here.forth.sum())
        found = search_about(place.submap.scored, self.grid, pose, distance, angle, least)
        if found is None:
            return pose, here
        there = self.judge(place, found)
        better = there.evidence - chance(distance, angle) > here.evidence
        return (found, there) if better else (pose, here)


def map_of_scans(submap: Submap) -> WholeMap:
    """The map that scans make."""
    return WholeMap(spread_points(submap.points, RESOLUTION), evidence_grid(submap))
