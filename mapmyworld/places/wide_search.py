"""The wide search: where a long path was driven and nothing recognised."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from mapmyworld.config import Config
from mapmyworld.geometry.planar import information_to_planar
from mapmyworld.places.laser_candidates import NEAR
from mapmyworld.places.laser_nodes import Index, LaserNodes, NodeScans, calm_spots, sessions_of
from mapmyworld.places.path_graph import PathGraph
from mapmyworld.types import CLOSURES, ConstraintKind, Judged

Array = NDArray[np.float64]
_CLOSURES = CLOSURES | {ConstraintKind.USER}
_SIGMAS = 2.0  # of the stated drift: where one place in twenty may be farther off
_MOST = 64  # earlier places that one is compared with, so that time grows as the path does


def lost_pairs(
    nodes: LaserNodes, constraints: Iterable[Judged], config: Config
) -> list[tuple[int, int]]:
    """(earlier, later) indices of places of a session that drift may have moved apart, however far.

    The nearest place of an earlier visit need not be the true one when poses are metres off:
    so every place within reach of the drift is compared, or of many some all over that reach. Its
    sigmas are those of the neighbour `constraints` between the two.
    """
    stated = _StatedDrift(nodes, constraints)
    size = config.places.laser_submap
    earlier = calm_spots(nodes, size)
    pairs: list[tuple[int, int]] = []
    for later in calm_spots(nodes, 2.0 * size).tolist():
        near = earlier[(earlier < later) & (nodes.session[earlier] == nodes.session[later])]
        drift = config.places.laser_drift * nodes.graph.driven(near, later)
        apart = np.hypot(*(nodes.poses[near, :2] - nodes.poses[later, :2]).T)
        reach = np.maximum(drift, _SIGMAS * stated.sigmas(near, later))
        worth = near[(drift > NEAR) & (apart < size + reach)]
        pairs += [(int(k), later) for k in worth[:: max(math.ceil(len(worth) / _MOST), 1)]]
    return pairs


class _StatedDrift:
    """How far apart tracking may have moved two nodes, by what the neighbour constraints state."""

    def __init__(self, nodes: LaserNodes, constraints: Iterable[Judged]) -> None:
        steps = [c for c in constraints if c.kind is ConstraintKind.NEIGHBOUR]
        rows = np.searchsorted(nodes.ids, [c.to_id for c in steps])
        stated = np.reshape([c.information for c in steps], (-1, 6, 6))
        known = np.linalg.inv(information_to_planar(stated))
        turned, moved = np.zeros((2, len(nodes.ids) + 1))
        np.add.at(turned, rows, known[:, 2, 2])
        np.add.at(moved, rows, known[:, 0, 0] + known[:, 1, 1])
        self._nodes, (x, y) = nodes, nodes.poses[:, :2].T
        turned, moved = turned[:-1], moved[:-1]
        each = [turned, turned * x, turned * y, turned * (x * x + y * y), moved]
        self._up_to = np.cumsum(each, axis=1)

    def sigmas(self, a: Index, b: int) -> Array:
        """(K,) metres, of where node b lies as seen from nodes `a` (K,) before it.

        What a step errs in heading counts by its distance from b. Closures shorten the way, and the
        sigma by as much.
        """
        path, (x, y) = self._nodes.path, self._nodes.poses[b, :2]
        turned, by_x, by_y, squared, moved = self._up_to[:, b, None] - self._up_to[:, a]
        swung = turned * (x * x + y * y) - 2.0 * (x * by_x + y * by_y) + squared
        shorter = self._nodes.graph.driven(a, b) / np.maximum(path[b] - path[a], 1e-9)
        return np.asarray(np.sqrt(np.maximum(swung, 0.0) + moved) * shorter)


def held_by(nodes: LaserNodes, constraints: Iterable[Judged]) -> LaserNodes:
    """The nodes, knowing which accepted closures hold them, and with joined sessions as one."""
    closures = _closures(constraints)
    session = _joined(nodes.ids, nodes.session, closures)
    row = {int(i): k for k, i in enumerate(nodes.ids)}
    ends = [(row[c.from_id], row[c.to_id]) for c in closures if {c.from_id, c.to_id} <= row.keys()]
    graph = PathGraph(nodes.path, np.array(ends, np.int64).reshape(-1, 2))
    return replace(nodes, graph=graph, session=session)


def joined_sessions(loaded: NodeScans, constraints: Iterable[Judged]) -> Index:
    """(N,) number of each node's session, those as one that accepted closures join."""
    ids = np.array([node.id for node in loaded.nodes], np.int64)
    return _joined(ids, sessions_of(loaded), _closures(constraints))


def _closures(constraints: Iterable[Judged]) -> list[Judged]:
    return [c for c in constraints if c.accepted and c.kind in _CLOSURES]


def _joined(ids: Index, session: Index, closures: Sequence[Judged]) -> Index:
    """(N,) numbers of sessions, those as one that closures tie."""
    if not closures or not session.any():
        return session
    ends = np.array([(c.from_id, c.to_id) for c in closures])
    ends = ends[np.isin(ends, ids).all(axis=1)]
    a, b = session[np.searchsorted(ids, ends)].T
    size = int(session.max()) + 1
    links = coo_array((np.ones(len(a)), (a, b)), shape=(size, size))
    return np.asarray(connected_components(links, directed=False)[1][session], np.int64)
