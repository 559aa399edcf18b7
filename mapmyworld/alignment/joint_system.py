"""What is known of aligned scans beside their pairs: motions, closures, and what was stated.

Priors, pins, landmarks, closures by images and what a person stated hold final poses by the same
factors as in the pose graph. Laser closures are carried to the nearest aligned scans.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mapmyworld.backend.system import System, with_edges
from mapmyworld.geometry import Array, Index
from mapmyworld.geometry.planar import (
    between_planar,
    information_to_planar,
    matrix_to_planar,
    planar_adjoint,
    planar_to_matrix,
)
from mapmyworld.geometry.rigid import between, invert, transported
from mapmyworld.graph.constraint_system import stated_system
from mapmyworld.odometry.tracking_losses import UNKNOWN
from mapmyworld.types import CLOSURES, ConstraintKind, Judged, Node, Poses, ScanMatch

Edges = tuple[Index, Index, Array, Array]
"""Tails, heads, relative poses (E, 3), information (E, 3, 3)."""


@dataclass(frozen=True, slots=True, eq=False)
class Statements:
    """Constraints that hold final poses, between nodes with scans, landmarks and the map."""

    constraints: tuple[Judged, ...]
    landmarks: tuple[int, ...]
    """Ids."""

    @staticmethod
    def of(nodes: Sequence[Node], constraints: Sequence[Judged]) -> Statements:
        """Those of the constraints that hold these nodes."""
        known = {node.id for node in nodes}
        used = [c for c in constraints if holds(c) and all(e < 0 or e in known for e in _ends(c))]
        landmarks = sorted({e for c in used for e in _ends(c) if e < 0}, reverse=True)
        return Statements(tuple(used), tuple(landmarks))

    def concerns(self, nodes: Sequence[Node]) -> Index:
        """(K,) indices of the nodes that any of them is about."""
        ends = {e for c in self.constraints for e in _ends(c)}
        return np.array([k for k, node in enumerate(nodes) if node.id in ends], np.int64)

    def places_of(self, poses: Poses) -> Array:
        """(L, 3) poses of the landmarks."""
        rows = np.array([np.flatnonzero(poses.ids == i)[0] for i in self.landmarks], np.int64)
        return matrix_to_planar(poses.map_from_node[rows])


NOTHING = Statements((), ())


def holds(constraint: Judged) -> bool:
    """Whether it holds poses itself: no neighbour, no closure by laser that nobody judged."""
    scanned = isinstance(constraint.source, ScanMatch) and not constraint.is_by_hand
    moved = constraint.kind is ConstraintKind.NEIGHBOUR
    return constraint.accepted and not (scanned or moved)


def is_by_laser(constraint: Judged) -> bool:
    """Whether an accepted closure comes from `laser_closures`, and no person judged it."""
    return constraint.accepted and constraint.kind in CLOSURES and not holds(constraint)


def _ends(constraint: Judged) -> tuple[int, int]:
    return constraint.from_id, constraint.to_id


def joint_system(
    nodes: Sequence[Node], chosen: Index, constraints: Sequence[Judged],
    stated: Statements, poses: Array, held: NDArray[np.bool_], spaced: Index,
) -> tuple[System, Array]:  # fmt: skip
    """The system of `chosen` (S,) nodes, some of those `spaced` (P,), and of the landmarks.

    Closures tie them whose ends both lie next to a chosen one: not those of laps that are left out.
    They are at `poses` (N, 3), N = S + L, of which those that are `held` (N,) stay. Then all poses
    (N + 1, 3), that of the map's own frame, which stays too, last.
    """
    ids = np.array([*(nodes[k].id for k in chosen.tolist()), *stated.landmarks], np.int64)
    known = stated_system(ids, planar_to_matrix(poses), stated.constraints, planar=True)
    system = with_edges(known.system, *_closed(nodes, chosen, constraints, spaced))
    return system.held(np.append(held, True)), np.concatenate([poses, np.zeros((1, 3))])


def node_motions(nodes: Sequence[Node], chosen: Index, constraints: Sequence[Judged]) -> Edges:
    """Motions between `chosen` nodes (S,), with the neighbours' covariances added up.

    Whole laps may lie between two of them, so that headings err by their lever arms. Relative
    poses (E, 3) and information (E, 3, 3), after the rows of tails and heads in `chosen`.
    """
    row_of = {node.id: row for row, node in enumerate(nodes)}
    steps = _steps(constraints, row_of)
    tracked = np.stack([node.tracked_from_base for node in nodes])
    if steps:
        rows = np.array([(row_of[c.from_id], row_of[c.to_id]) for c in steps])
        tracked = _as_measured(tracked, rows, np.stack([c.i_from_j for c in steps]))
    covariances = step_covariances(nodes, constraints)
    planar = matrix_to_planar(tracked)
    ends = np.repeat(chosen[1:], np.diff(chosen))
    after = between_planar(planar[ends], planar[chosen[0] + 1 : chosen[-1] + 1])
    moved = transported(planar_adjoint(after), covariances[chosen[0] : chosen[-1]])
    summed = np.add.reduceat(moved, chosen[:-1] - chosen[0], axis=0)
    information = np.asarray(np.linalg.inv(summed + 1e-9 * np.eye(3)), np.float64)
    sessions = np.array([nodes[k].session for k in chosen])
    within = np.flatnonzero(sessions[:-1] == sessions[1:])
    measured = between_planar(planar[chosen[within]], planar[chosen[within + 1]])
    return within, within + 1, measured, information[within]


def step_covariances(nodes: Sequence[Node], constraints: Sequence[Judged]) -> Array:
    """(N, 3, 3) by how much the motion from each of the nodes to the next may be off."""
    row_of = {node.id: row for row, node in enumerate(nodes)}
    covariances = np.broadcast_to(np.diag(UNKNOWN), (len(nodes), 3, 3)).copy()
    steps = [c for c in _steps(constraints, row_of) if c.accepted]
    if steps:
        known = information_to_planar(np.stack([c.information for c in steps]))
        covariances[[row_of[c.from_id] for c in steps]] = np.linalg.inv(known)
    return covariances


def _steps(constraints: Sequence[Judged], row_of: Mapping[int, int]) -> list[Judged]:
    return [
        c for c in constraints
        if c.kind == ConstraintKind.NEIGHBOUR and c.from_id in row_of and c.to_id in row_of
    ]  # fmt: skip


def _as_measured(tracked: Array, rows: Index, measured: Array) -> Array:
    """Tracked poses (N, 4, 4), all after a motion that was measured anew moved with it.

    `rows` (E, 2) are the nodes of motions, `measured` (E, 4, 4) what is known of them now.
    """
    steps, poses = between(tracked[:-1], tracked[1:]), tracked.copy()
    measured_to = {int(after): (int(before), k) for k, (before, after) in enumerate(rows)}
    for after in range(1, len(tracked)):
        if after in measured_to:
            before, k = measured_to[after]
            poses[after] = poses[before] @ measured[k]
        else:
            poses[after] = poses[after - 1] @ steps[after - 1]
    return poses


def _closed(
    nodes: Sequence[Node], chosen: Index, constraints: Sequence[Judged], spaced: Index
) -> Edges:
    """Accepted laser closures between chosen nodes that are the nearest of those spaced (P,)."""
    row_of = {node.id: row for row, node in enumerate(nodes)}
    found = [
        c for c in constraints
        if is_by_laser(c) and c.from_id in row_of and c.to_id in row_of
    ]  # fmt: skip
    if not found:
        return np.zeros(0, np.int64), np.zeros(0, np.int64), np.zeros((0, 3)), np.zeros((0, 3, 3))
    rows = np.array([(row_of[c.from_id], row_of[c.to_id]) for c in found])
    near = np.searchsorted(chosen, rows, side="right") - 1
    spot = spaced[np.searchsorted(spaced, rows, side="right") - 1]
    matrices = np.stack([node.tracked_from_base for node in nodes])
    aside = between(matrices[chosen[near]], matrices[rows])
    measured = np.stack([c.i_from_j for c in found])
    moved = aside[:, 0] @ measured @ invert(aside[:, 1])
    known = information_to_planar(np.stack([c.information for c in found]))
    keep = (near[:, 0] != near[:, 1]) & (chosen[near] == spot).all(axis=1)
    return near[keep, 0], near[keep, 1], matrix_to_planar(moved)[keep], known[keep]
