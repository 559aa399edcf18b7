"""The least-squares problem of a pose graph as arrays."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from mapmyworld.backend.connected_components import held_nodes
from mapmyworld.backend.landmarks import sighting_residuals
from mapmyworld.backend.residuals import edge_residuals, squared_sigmas
from mapmyworld.geometry import Array, Index
from mapmyworld.geometry.planar import planar_exp
from mapmyworld.geometry.rigid import se3_exp
from mapmyworld.geometry.rotations import rotation_angle

Objects = NDArray[np.object_]


@dataclass(frozen=True, slots=True, eq=False)
class System:
    """Edges between positions, and where each free node stands in the vector of unknowns."""

    planar: bool
    tails: Index
    """(E,) positions of nodes."""
    heads: Index
    """(E,) positions of nodes, which an edge measures in the frame of its tail."""
    measured: Array
    """(E, 3 or 4, 4) tail_from_head."""
    information: Array
    """(E, d, d) of perturbations of it, d = 3 or 6."""
    free: Index
    """(N,) number of each node among the free ones; -1 for those that stay."""
    kinds: Index | None = None
    """(E,) POINT or POLAR for sightings of landmarks, 0 for edges; None = all edges."""
    factors: Objects | None = None
    """(E,) gtsam's of edges between free nodes, kept where many parts of the system are solved."""

    @property
    def dimension(self) -> int:
        """Unknowns of a node."""
        return 3 if self.planar else 6

    @property
    def points(self) -> NDArray[np.bool_]:
        """(N,) nodes that are landmarks, of which only the position is unknown."""
        found = np.zeros(len(self.free), np.bool_)
        if self.kinds is not None:
            found[self.heads[self.kinds > 0]] = True
        return found

    @property
    def size(self) -> int:
        """Unknowns in all."""
        return self.dimension * int(self.free.max(initial=-1) + 1)

    def held(self, stays: NDArray[np.bool_]) -> System:
        """The same where these nodes (N,) stay, and all others move."""
        return replace(self, free=number_free(stays))


@dataclass(frozen=True, slots=True, eq=False)
class Fit:
    """Poses of all nodes, and how they fit the edges."""

    poses: Array
    """(N, 3 or 4, 4) map_from_node."""
    residuals: Array
    """(E, d)."""
    squares: Array
    """(E,) squared sigmas."""
    chi2: float
    """Their sum."""

    @property
    def cost(self) -> float:
        """Half the sum of squared sigmas."""
        return 0.5 * self.chi2


def number_free(stays: NDArray[np.bool_]) -> Index:
    """(N,) 0, 1, ... over the nodes that do not stay, -1 for those that do, of a mask (N,)."""
    moves = ~stays
    return np.asarray(moves.cumsum() * moves - 1)


def chosen_edges(system: System, which: NDArray[np.bool_] | Index) -> System:
    """The system with some of its edges, by mask (E,) or positions (K,)."""
    return replace(
        system,
        tails=system.tails[which],
        heads=system.heads[which],
        measured=system.measured[which],
        information=system.information[which],
        kinds=None if system.kinds is None else system.kinds[which],
        factors=None if system.factors is None else system.factors[which],
    )


def with_edges(
    system: System, tails: Index, heads: Index, measured: Array, information: Array
) -> System:
    """A system without landmarks with more edges, after its own.

    `tails`, `heads` (K,) are positions of nodes, `measured` (K, 3 or 4, 4) tail_from_head, with
    `information` (K, d, d).
    """
    return replace(
        system,
        tails=np.concatenate([system.tails, tails]),
        heads=np.concatenate([system.heads, heads]),
        measured=np.concatenate([system.measured, measured]),
        information=np.concatenate([system.information, information]),
        factors=None,
    )


def with_information(system: System, first: int, information: Array) -> System:
    """The system where edges from the `first` on have other information (K, d, d)."""
    found = system.information.copy()
    found[first : first + len(information)] = information
    return replace(system, information=found, factors=None)


def believed_edges(system: System, which: NDArray[np.bool_]) -> System:
    """The system with edges of a mask (E,); the first node of every component they leave stays."""
    part, held = chosen_edges(system, which), np.flatnonzero(system.free < 0)
    stays = held_nodes(len(system.free), part.tails, part.heads, held)
    return replace(part, free=number_free(stays))


def moving_edges(system: System) -> NDArray[np.bool_]:
    """(E,) edges with an end that does not stay."""
    return np.asarray((system.free[system.tails] >= 0) | (system.free[system.heads] >= 0))


def fit_of(system: System, poses: Array) -> Fit:
    """How `poses` (N, 3 or 4, 4), map_from_node, fit the edges of a system."""
    tails, heads = poses[system.tails], poses[system.heads]
    residuals = edge_residuals(system.planar, tails, heads, system.measured)
    if system.kinds is not None:
        k = np.flatnonzero(system.kinds)
        seen = tails[k], heads[k], system.measured[k], system.kinds[k]
        residuals[k] = sighting_residuals(system.planar, *seen)
    squares = squared_sigmas(residuals, system.information)
    return Fit(poses, residuals, squares, float(np.add.reduce(squares)))


def edge_chi2(system: System, poses: Array) -> Array:
    """(E,) squared sigmas of every edge at `poses` (N, 3 or 4, 4)."""
    return fit_of(system, poses).squares


def missed_by(system: System, poses: Array) -> tuple[Array, Array]:
    """Metres and degrees, (E,) both, by which every edge is missed at `poses` (N, 3 or 4, 4)."""
    residuals = fit_of(system, poses).residuals
    if system.planar:
        motion = planar_exp(residuals)
        return np.linalg.norm(motion[:, :2], axis=1), np.degrees(np.abs(motion[:, 2]))
    motion = se3_exp(residuals)
    return np.linalg.norm(motion[:, :3, 3], axis=1), np.degrees(rotation_angle(motion))
