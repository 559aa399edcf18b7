"""How far one drives from node to node, by the path and the closures that shorten it."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import coo_array, csr_array
from scipy.sparse.csgraph import connected_components, dijkstra

Array = NDArray[np.float64]
Index = NDArray[np.int64]
NO_PAIRS = np.zeros((0, 2), np.int64)


class PathGraph:
    """Nodes along a path, some of which closures join: what drifts is the shortest way between."""

    def __init__(self, path: Array, closed: Index) -> None:
        """`path` (N,) is metres driven up to each node, `closed` (C, 2) nodes at one place."""
        self._path = path
        self._tied, ends = np.unique(closed, return_inverse=True)
        ends = ends.reshape(-1, 2)
        size = len(self._tied)
        joined = coo_array((np.ones(len(ends)), (ends[:, 0], ends[:, 1])), shape=(size, size))
        count, place = connected_components(joined, directed=False) if size else (0, ends[:, 0])
        self._place = np.asarray(place, np.int64)
        self._ways = _ways(self._place, np.diff(path[self._tied]), count) if size else None
        self._from: dict[int, Array] = {}

    def driven(self, a: Index | int, b: int) -> Array:
        """Metres (...) of the shortest way from nodes `a` (...) to node `b`, indices both."""
        direct = np.abs(self._path[a] - self._path[b])
        if self._ways is None:
            return np.asarray(direct)
        found = [direct]
        for here in self._beside(b):
            for there in self._beside(a):
                aside = np.abs(self._path[self._tied[there]] - self._path[a])
                aside = aside + abs(self._path[self._tied[here]] - self._path[b])
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
