"""The least-squares problem of a pose graph as arrays."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from mapmyworld.geometry import Array
from mapmyworld.graph.landmarks import sighting_jacobians, sighting_residuals
from mapmyworld.graph.pose_graph import Index, components
from mapmyworld.graph.residuals import edge_jacobians, edge_residuals, squared_sigmas


@dataclass(frozen=True, slots=True, eq=False)
class System:
    """Edges between positions, and where each free node stands in the vector of unknowns."""

    planar: bool
    tails: Index
    heads: Index
    """(E,) positions of nodes."""
    measured: Array
    information: Array
    """(E, 3 or 4, 4) and (E, d, d)."""
    free: Index
    """(N,) number of each node among the free ones; -1 for those that stay."""
    kinds: Index | None = None
    """(E,) POINT or POLAR for sightings of landmarks, 0 for edges; None = all edges."""

    @property
    def dimension(self) -> int:
        """Unknowns of a node."""
        return 3 if self.planar else 6

    @property
    def size(self) -> int:
        """Unknowns in all."""
        return self.dimension * int(self.free.max(initial=-1) + 1)


def number_free(node_count: int, fixed: Index) -> Index:
    """(N,) 0, 1, ... over the nodes that are not fixed, and -1 for those that are."""
    is_free = np.ones(node_count, np.bool_)
    is_free[fixed] = False
    return np.where(is_free, np.cumsum(is_free) - 1, -1).astype(np.int64)


def residuals_of(system: System, poses: Array) -> Array:
    """(E, d) residuals of edges and sightings."""
    tails, heads = poses[system.tails], poses[system.heads]
    residuals = edge_residuals(system.planar, tails, heads, system.measured)
    if system.kinds is not None:
        k = np.flatnonzero(system.kinds)
        residuals[k] = sighting_residuals(
            system.planar, tails[k], heads[k], system.measured[k], system.kinds[k]
        )
    return residuals


def jacobians_of(system: System, poses: Array, residuals: Array) -> tuple[Array, Array]:
    """Derivatives (E, d, d) of these residuals by tangents of tails and heads."""
    tails, heads = poses[system.tails], poses[system.heads]
    by_tail, by_head = edge_jacobians(system.planar, tails, heads, residuals)
    if system.kinds is not None:
        k = np.flatnonzero(system.kinds)
        found = sighting_jacobians(system.planar, tails[k], heads[k], system.kinds[k])
        by_tail[k], by_head[k] = found
    return by_tail, by_head


def chosen_edges(system: System, which: NDArray[np.bool_] | Index) -> System:
    """The system with some of its edges."""
    return replace(
        system,
        tails=system.tails[which],
        heads=system.heads[which],
        measured=system.measured[which],
        information=system.information[which],
        kinds=None if system.kinds is None else system.kinds[which],
    )


def believed_edges(system: System, which: NDArray[np.bool_]) -> System:
    """The system with some of its edges; the first node of every part they leave loose stays."""
    part = chosen_edges(system, which)
    number = components(len(system.free), part.tails, part.heads)
    held = np.flatnonzero(system.free < 0)
    first = np.unique(number, return_index=True)[1]
    loose = first[~np.isin(number[first], number[held])]
    if len(loose) == 0:
        return part
    return replace(part, free=number_free(len(system.free), np.concatenate([held, loose])))


def edge_chi2(system: System, poses: Array) -> Array:
    """(E,) squared sigmas of every edge at `poses`."""
    return squared_sigmas(residuals_of(system, poses), system.information)
