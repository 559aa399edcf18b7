"""How far poses may have drifted along a path, and how closures shorten the way."""

from __future__ import annotations

import functools
from collections.abc import Iterable, Sequence

import numpy as np
from scipy.sparse import csr_array
from scipy.sparse.csgraph import dijkstra

from mapmyworld.backend.connected_components import components
from mapmyworld.geometry import Array, Index
from mapmyworld.geometry.planar import information_to_planar
from mapmyworld.odometry.unobserved_motion import FARTHEST
from mapmyworld.places.doubted_odometry import fault_variances
from mapmyworld.types import ConstraintKind, Judged

NO_PAIRS = np.zeros((0, 2), np.int64)
SIGMAS = 3.0  # of what is stated: as far as drift is searched


class PathDrift:
    """Nodes along a path, some of which closures join: two nodes drift apart by what motions err on
    the best way between them over path and closures.

    Where tracking was lost the path grows by more than maps reach, and the drift by as much: no
    submap spans a loss, and no way across one is the best.
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
        moved, turned = np.where(lost, 0.0, variances.T)
        (x, y), off = poses[:, :2].T, np.where(lost, FARTHEST**2, moved)
        each = [turned, turned * x, turned * y, turned * (x * x + y * y), off]
        self._up_to = np.cumsum(each, axis=1)
        self._turned_up_to = np.cumsum(np.where(lost, np.pi**2, turned))
        self._ways = Ways(closed)
        # Of those that are asked for from many nodes one after the other.
        self._moved_up_to = functools.lru_cache(self._all_moved_up_to)
        self._moved_from, self._turned_from = dict[int, Array](), dict[int, Array]()

    @property
    def is_without_faults(self) -> bool:
        """Whether odometry in doubt counts as it was measured."""
        return self._faults is not None

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
        """Metres (...) and radians (...) by which node b may lie off, seen from nodes `a` (...)."""
        turned = self._turned_up_to
        if b not in self._turned_from:
            self._turned_from[b] = self._ways.costs(turned, b)
        radians = np.sqrt(self._ways.least(turned, self._turned_from[b], a, b))
        return self.metres(a, b), SIGMAS * radians

    def metres(self, a: Index | int, b: int) -> Array:
        """Metres (...) by which node b may lie off, seen from nodes `a` (...).

        What a motion errs in heading counts by its distance from b.
        """
        moved = self._moved_up_to(b)
        if b not in self._moved_from:
            self._moved_from[b] = self._ways.costs(moved, b)
        return SIGMAS * np.sqrt(self._ways.least(moved, self._moved_from[b], a, b))

    def within(self, sections: Iterable[tuple[int, Index]]) -> Array:
        """(3, 3) covariance by which nodes lie off from what sections of the path about them show,
        all added: of each section its middle and its nodes (K,).

        Any part of a section may be the one that shows it.
        """
        moved = turned = 0.0
        for middle, nodes in sections:
            up_to = self._all_moved_up_to(middle)
            moved += float(np.abs(up_to[nodes] - up_to[middle]).mean())
            up_to = self._turned_up_to
            turned += float(np.abs(up_to[nodes] - up_to[middle]).mean())
        return np.diag([0.5 * moved, 0.5 * moved, turned])

    def _all_moved_up_to(self, b: int) -> Array:
        """(N,) m^2 by which all motions up to each node move node b."""
        x, y = self._poses[b, :2]
        turned, by_x, by_y, squared, moved = self._up_to
        swung = turned * (x * x + y * y) - 2.0 * (x * by_x + y * by_y) + squared
        return np.maximum.accumulate(swung + moved)


class Ways:
    """Ways between nodes over the path and closures, by any cost that adds up along the path."""

    def __init__(self, closed: Index) -> None:
        """`closed` (C, 2) are nodes at one place."""
        self._tied, ends = np.unique(closed, return_inverse=True)
        ends, size = ends.reshape(-1, 2), len(self._tied)
        self._place = components(size, *ends.T)
        self._count = int(self._place.max(initial=-1)) + 1
        ends = np.sort(np.stack([self._place[:-1], self._place[1:]]), axis=0)
        key = ends[0] * self._count + ends[1]
        self._stretches = np.argsort(key, kind="stable")
        self._firsts = np.flatnonzero(np.diff(key[self._stretches], prepend=-1))
        rows, self._columns = ends[:, self._stretches[self._firsts]]
        self._rows = np.searchsorted(rows, np.arange(self._count + 1))

    def costs(self, up_to: Array, b: int) -> Array:
        """(P,) of the best way from node `b` to each place, `up_to` (N,) being the costs of the
        path up to each node.
        """
        if self._count == 0:
            return np.zeros(0)
        lengths = np.diff(up_to[self._tied])[self._stretches]
        best = np.minimum.reduceat(lengths, self._firsts) if len(lengths) else lengths
        shape = self._count, self._count
        graph = csr_array((best, self._columns, self._rows), shape=shape)
        beside = np.array(self._beside(b))
        onward = dijkstra(graph, directed=False, indices=self._place[beside])
        aside = np.abs(up_to[self._tied[beside]] - up_to[b])
        return np.asarray((aside[:, None] + onward).min(axis=0))

    def least(self, up_to: Array, costs: Array, a: Index | int, b: int) -> Array:
        """(...) of the best way from nodes `a` (...) to node `b`, given the `costs` (P,) from b and
        those of the path, `up_to` (N,).
        """
        found = np.abs(up_to[a] - up_to[b])
        if self._count:
            for beside in self._beside(a):
                aside = np.abs(up_to[self._tied[beside]] - up_to[a])
                found = np.minimum(found, aside + costs[self._place[beside]])
        return np.asarray(found)

    def _beside(self, nodes: Index | int) -> tuple[Index, Index]:
        """Rows (...) of the tied nodes before and after some nodes (...)."""
        after = np.minimum(np.searchsorted(self._tied, nodes), len(self._tied) - 1)
        return np.maximum(after - 1, 0), after


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
