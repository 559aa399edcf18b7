"""A pose graph as arrays: what graph files hold and what the back end optimises."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from mapmyworld.types.rows import CountedRows


@dataclass(frozen=True, slots=True, eq=False)
class Edges(CountedRows):
    """Measured relative poses between pairs of nodes."""

    from_ids: NDArray[np.int64]
    """(E,) ids of nodes."""
    to_ids: NDArray[np.int64]
    """(E,) ids of nodes."""
    i_from_j: NDArray[np.float64]
    """(E, 3) as x, y, yaw in a planar graph, else (E, 4, 4)."""
    information: NDArray[np.float64]
    """(E, 3, 3) over x, y, yaw in a planar graph, else (E, 6, 6), rotation first."""
    odometry: NDArray[np.bool_]
    """(E,) whether robust optimisation takes the edge as true without asking."""


@dataclass(frozen=True, slots=True, eq=False)
class Sightings(CountedRows):
    """Landmarks (points) seen from nodes, with known correspondence."""

    node_ids: NDArray[np.int64]
    """(K,) ids of nodes."""
    landmark_ids: NDArray[np.int64]
    """(K,) ids of landmarks."""
    measured: NDArray[np.float64]
    """(K, 2 or 3): position in the node's frame, or bearing (rad) and range (m), planar only."""
    information: NDArray[np.float64]
    """(K, 2, 2) or (K, 3, 3)."""
    polar: NDArray[np.bool_]
    """(K,) whether `measured` is bearing and range."""


@dataclass(frozen=True, slots=True, eq=False)
class Priors(CountedRows):
    """Measured poses of single nodes in the map frame."""

    ids: NDArray[np.int64]
    """(P,)."""
    map_from_node: NDArray[np.float64]
    """(P, 3) or (P, 4, 4)."""
    information: NDArray[np.float64]
    """(P, 3, 3) or (P, 6, 6)."""


def no_sightings(planar: bool) -> Sightings:
    """None, in the right shapes."""
    size, ids = (2 if planar else 3), np.zeros(0, np.int64)
    return Sightings(
        ids, ids, np.zeros((0, size)), np.zeros((0, size, size)), np.zeros(0, np.bool_)
    )


def no_priors(planar: bool) -> Priors:
    """None, in the right shapes."""
    if planar:
        return Priors(np.zeros(0, np.int64), np.zeros((0, 3)), np.zeros((0, 3, 3)))
    return Priors(np.zeros(0, np.int64), np.zeros((0, 4, 4)), np.zeros((0, 6, 6)))


@dataclass(frozen=True, slots=True, eq=False)
class PoseGraph:
    """Nodes with guesses or solutions, and the constraints between them."""

    planar: bool
    ids: NDArray[np.int64]
    """(N,) ascending."""
    map_from_node: NDArray[np.float64]
    """(N, 3) as x, y, yaw when planar, else (N, 4, 4)."""
    edges: Edges
    landmark_ids: NDArray[np.int64] = field(default_factory=lambda: np.zeros(0, np.int64))
    """(L,) ascending; numbered apart from the nodes."""
    landmarks: NDArray[np.float64] = field(default_factory=lambda: np.zeros((0, 2)))
    """(L, 2 or 3) positions in the map frame."""
    sightings: Sightings = field(default_factory=lambda: no_sightings(True))
    priors: Priors = field(default_factory=lambda: no_priors(True))
    fixed_ids: NDArray[np.int64] = field(default_factory=lambda: np.zeros(0, np.int64))
    """(F,) nodes that stay where they are."""

    def __len__(self) -> int:
        return len(self.ids)
