"""Whether a filter has diverged: visits to a place that contradict each other in its map.

The filter's own weights cannot show it: of particles that are all wrong one is the best. But
where a path meets itself two visits saw the same surfaces, and in a map that fell apart one saw
through what the other took for a wall. What they report of each other's points is the evidence that
recognition decides by: points on surfaces, less points in cells that were seen free.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree
from scipy.stats import binom

from mapmyworld.geometry import Array
from mapmyworld.geometry.planar import between_planar, compose_planar, transform_points_planar
from mapmyworld.particles.kernels.surface_tiles import Beams
from mapmyworld.registration.place_evidence import Place
from mapmyworld.registration.scan_search import MARGIN, Submap

_LENGTH = 5.0  # m of path that make a place: a filter hardly drifts in so little
_AWAY = 15.0  # m of path between two visits of a place
_NEAR = 8.0  # m between the middles of places that share surfaces
_CHANCE = 0.01  # of evidence beyond `MARGIN` against a pose that is right; and of a false alarm


@dataclass(frozen=True, slots=True)
class Contradictions:
    """Visits compared in the final map."""

    compared: int
    """Pairs that know enough of each other's points."""
    contradicting: int
    """Of these, pairs that are a hundred times as likely to have seen different places."""

    @property
    def diverged(self) -> bool:
        """Whether more pairs contradict than do by chance where all are right."""
        return bool(binom.sf(self.contradicting - 1, self.compared, _CHANCE) < _CHANCE)


def contradictions(path: Array, scans: Sequence[Beams]) -> Contradictions:
    """What visits to the same places report of each other, given the path (K, 3) of the scans."""
    travelled = np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(path[:, :2], axis=0).T))])
    begins = np.flatnonzero(np.diff(np.floor(travelled / _LENGTH))) + 1
    members = np.split(np.arange(len(path)), begins)
    middles = np.array([some[len(some) // 2] for some in members])
    places = [_place(path, scans, some, k) for some, k in zip(members, middles, strict=True)]
    compared, against = 0, 0
    for i, j in _revisits(path[middles], travelled[middles]):
        found = places[i].agreement_with(
            places[j], between_planar(path[middles[i]], path[middles[j]])
        )
        known = np.count_nonzero(found.forth) + np.count_nonzero(found.back)
        compared += int(known > MARGIN)
        against += int(found.evidence < -MARGIN)
    return Contradictions(compared, against)


def _revisits(middles: Array, travelled: Array) -> NDArray[np.int64]:
    """Pairs (V, 2) of places that are near each other, and far apart along the path."""
    pairs = cKDTree(middles[:, :2]).query_pairs(_NEAR, output_type="ndarray")
    return np.asarray(pairs[np.abs(travelled[pairs[:, 1]] - travelled[pairs[:, 0]]) > _AWAY])


def _place(path: Array, scans: Sequence[Beams], members: NDArray[np.int64], middle: int) -> Place:
    """The place that the scans `members` saw, in the frame of the one at its middle."""
    poses = between_planar(path[middle], path[members])
    seen = [scans[k] for k in members]
    points = [transform_points_planar(x, z.points) for x, z in zip(poses, seen, strict=True)]
    origins = np.array([np.append(z.origin, 0.0) for z in seen])
    bounds = np.cumsum([0, *(len(some) for some in points)])
    origins = compose_planar(poses, origins)[:, :2]
    submap = Submap(np.concatenate(points), np.ascontiguousarray(origins), bounds.astype(np.int64))
    return Place.of(submap)
