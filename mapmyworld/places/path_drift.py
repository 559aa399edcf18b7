"""How far poses may have drifted along a path, and how closures shorten the way."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import coo_array, csr_array
from scipy.sparse.csgraph import connected_components, dijkstra

from mapmyworld.geometry.planar import information_to_planar
from mapmyworld.odometry.pose_hypotheses import FAULT_SIZE
from mapmyworld.odometry.unobserved_motion import FARTHEST
from mapmyworld.types import ConstraintKind, Judged

Array = NDArray[np.float64]
Index = NDArray[np.int64]
NO_PAIRS = np.zeros((0, 2), np.int64)
SIGMAS = 3.0  # of what is stated: as far as drift is searched


class PathDrift:
    """Nodes along a path, some of which closures join: what drifts is the shortest way between.

    Where tracking was lost the path grows by more than maps reach, as if the robot had moved on: no
    submap spans a loss, and no way across one is the shortest.
    """

    def __init__(
        self,
        tracked: Array,
        poses: Array,
        variances: Array,
        closed: Index = NO_PAIRS,
        faults: Array | None = None,
    ) -> None:
        """`tracked` (N,) is metres of path up to each of the nodes at `poses` (N, 3).

        `closed` (C, 2) are nodes at one place. `variances` (N, 2), m^2 and rad^2, are those of the
        motion to each node, infinite where tracking was lost, and `faults` (N, 2) what a fault adds
        where odometry is in doubt.
        """
        self.tracked, self._poses, self._variances = tracked, poses, variances
        self._closed, self._faults = closed, faults
        lost = np.isinf(variances).any(axis=1)
        self.path = tracked + FARTHEST * np.cumsum(lost)
        self._tied, ends = np.unique(closed, return_inverse=True)
        ends = ends.reshape(-1, 2)
        size = len(self._tied)
        joined = coo_array((np.ones(len(ends)), (ends[:, 0], ends[:, 1])), shape=(size, size))
        count, place = connected_components(joined, directed=False) if size else (0, ends[:, 0])
        self._place = np.asarray(place, np.int64)
        self._ways = _ways(self._place, np.diff(self.path[self._tied]), count) if size else None
        self._from: dict[int, Array] = {}
        (moved, turned), (x, y) = np.where(lost, 0.0, variances.T), poses[:, :2].T
        each = [turned, turned * x, turned * y, turned * (x * x + y * y), moved]
        self._up_to = np.cumsum(each, axis=1)

    def held_by(self, closed: Index) -> PathDrift:
        """The same path, with closures (C, 2) that join nodes."""
        return PathDrift(self.tracked, self._poses, self._variances, closed, self._faults)

    def with_faults(self) -> PathDrift:
        """The same, with a fault wherever odometry is in doubt and no closure spans it."""
        if self._faults is None:
            return self
        first, last = np.sort(self._closed, axis=1).T
        rows = np.arange(len(self._faults))
        spanned = np.searchsorted(np.sort(first), rows) > np.searchsorted(np.sort(last), rows)
        variances = self._variances + np.where(spanned[:, None], 0.0, self._faults)
        return PathDrift(self.tracked, self._poses, variances, self._closed)

    def reach(self, a: Index | int, b: int) -> tuple[Array, Array]:
        """Metres (...) and radians (...) by which node b may lie off, as seen from nodes `a` (...).

        What a motion errs in heading counts by its distance from b. Closures shorten the way, and
        the drift by as much.
        """
        (x, y), first, last = self._poses[b, :2], np.minimum(a, b), np.maximum(a, b)
        turned, by_x, by_y, squared, moved = self._up_to[:, last] - self._up_to[:, first]
        swung = turned * (x * x + y * y) - 2.0 * (x * by_x + y * by_y) + squared
        way = np.maximum(self.tracked[last] - self.tracked[first], 1e-9)
        shorter = SIGMAS * self.driven(a, b) / way
        return shorter * np.sqrt(np.maximum(swung, 0.0) + moved), shorter * np.sqrt(turned)

    def driven(self, a: Index | int, b: int) -> Array:
        """Metres (...) of the shortest way from nodes `a` (...) to node `b`, indices both."""
        direct = np.abs(self.path[a] - self.path[b])
        if self._ways is None:
            return np.asarray(direct)
        found = [direct]
        for here in self._beside(b):
            for there in self._beside(a):
                aside = np.abs(self.path[self._tied[there]] - self.path[a])
                aside = aside + abs(self.path[self._tied[here]] - self.path[b])
                found.append(aside + self._distances(int(self._place[here]))[self._place[there]])
        return np.asarray(np.min(found, axis=0))

    def _beside(self, nodes: Index | int) -> tuple[Index, Index]:
        """Rows (...) of the tied nodes before and after some nodes (...)."""
        after = np.minimum(np.searchsorted(self._tied, nodes), len(self._tied) - 1)
        return np.maximum(after - 1, 0), after

    def _distances(self, place: int) -> Array:
        if place not in self._from:
            self._from[place] = dijkstra(self._ways, directed=False, indices=place)
        return self._from[place]


def stated_variances(ids: Index, constraints: Sequence[Judged]) -> Array:
    """(N, 2) m^2 and rad^2 of the motions to each of ascending nodes (N,), as they were measured.

    Infinite where tracking was lost.
    """
    steps = [c for c in constraints if c.kind is ConstraintKind.NEIGHBOUR and c.accepted]
    rows = np.searchsorted(ids, [c.to_id for c in steps])
    stated = np.reshape([c.information for c in steps], (-1, 6, 6))
    known = np.linalg.inv(information_to_planar(stated))
    variances = np.zeros((len(ids) + 1, 2))
    np.add.at(variances, rows, np.stack([known[:, 0, 0] + known[:, 1, 1], known[:, 2, 2]], axis=1))
    variances[np.searchsorted(ids, [c.to_id for c in constraints if c.is_tracking_loss])] = np.inf
    return variances[:-1] - fault_variances(ids, constraints)


def fault_variances(ids: Index, constraints: Sequence[Judged]) -> Array:
    """(N, 2) m^2 and rad^2 that a fault adds to motions in doubt, to nodes `ids` (N,)."""
    variances = np.zeros((len(ids) + 1, 2))
    doubted = [c.to_id for c in constraints if c.accepted and c.is_doubted]
    x, y, yaw = np.square(FAULT_SIZE)
    variances[np.searchsorted(ids, doubted)] = x + y, yaw
    return variances[:-1]


def _ways(place: Index, lengths: Array, count: int) -> csr_array:
    """(count, count) the shortest stretch of path between each two places (T,) that follow each
    other, `lengths` (T - 1,) metres apart.
    """
    ends = np.sort(np.stack([place[:-1], place[1:]]), axis=0)
    ends, lengths = ends[:, ends[0] != ends[1]], lengths[ends[0] != ends[1]]
    key = ends[0].astype(np.int64) * count + ends[1]
    order = np.lexsort((lengths, key))
    first = order[np.flatnonzero(np.diff(key[order], prepend=-1))]
    return coo_array(
        (lengths[first], (ends[0][first], ends[1][first])), shape=(count, count)
    ).tocsr()
