"""What holds final poses beside scans and odometry: priors, pins, landmarks, images, a person.

Laser closures do not, unless a person stated one: their scans are aligned themselves.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mapmyworld.geometry.planar import information_to_planar, matrix_to_planar
from mapmyworld.registration.joint_equations import Motions
from mapmyworld.types import ConstraintKind, Judge, Judged, Poses, ScanMatch

Array = NDArray[np.float64]
Index = NDArray[np.int64]


@dataclass(frozen=True, slots=True, eq=False)
class Statements:
    """Constraints between nodes with scans, landmarks and the map's own frame."""

    tails: Index
    heads: Index
    """(K,) rows: of nodes, then of landmarks, then of the map's frame."""
    tail_from_head: Array
    """(K, 3)."""
    information: Array
    """(K, 3, 3) of the right perturbation."""
    nodes: int
    """How many rows are nodes'."""
    landmarks: Index
    """(L,) ids."""

    @property
    def stated(self) -> Index:
        """The nodes that any of them concerns."""
        ends = np.concatenate([self.tails, self.heads])
        return np.asarray(np.unique(ends[ends < self.nodes]))

    @property
    def places(self) -> bool:
        """Whether one of them says where something lies in the map."""
        return bool((self.tails == self.nodes + len(self.landmarks)).any())

    def among(self, chosen: Index) -> Motions:
        """The same where `chosen` (S,) nodes, all that they concern, are the first rows."""
        row = np.full(self.nodes + len(self.landmarks) + 1, -1, np.int64)
        row[chosen] = np.arange(len(chosen))
        row[self.nodes :] = len(chosen) + np.arange(len(self.landmarks) + 1)
        return Motions(row[self.tails], row[self.heads], self.tail_from_head, self.information)

    def others(self, poses: Poses) -> Array:
        """(L + 1, 3) poses of the landmarks and of the map's frame."""
        rows = [int(np.flatnonzero(poses.ids == i)[0]) for i in self.landmarks]
        return matrix_to_planar(np.concatenate([poses.map_from_node[rows], np.eye(4)[None]]))


def statements_of(ids: Sequence[int], constraints: Sequence[Judged]) -> Statements:
    """Those of the constraints that hold the poses of nodes with these ids."""
    known = set(ids)
    used = [c for c in constraints if holds(c) and all(e < 0 or e in known for e in _ends(c))]
    landmarks = sorted({e for c in used for e in _ends(c) if e < 0}, reverse=True)
    row = {i: k for k, i in enumerate([*ids, *landmarks])}
    tails = [len(row) if c.from_id == c.to_id else row[c.from_id] for c in used]
    return Statements(
        np.array(tails, np.int64),
        np.array([row[c.to_id] for c in used], np.int64),
        matrix_to_planar(np.array([c.i_from_j for c in used]).reshape(-1, 4, 4)),
        information_to_planar(np.array([c.information for c in used]).reshape(-1, 6, 6)),
        len(ids),
        np.array(landmarks, np.int64),
    )


def joined(first: Motions, second: Motions) -> Motions:
    """The motions of both."""
    return Motions(
        np.concatenate([first.tails, second.tails]),
        np.concatenate([first.heads, second.heads]),
        np.concatenate([first.tail_from_head, second.tail_from_head]),
        np.concatenate([first.information, second.information]),
    )


def _ends(constraint: Judged) -> tuple[int, int]:
    return constraint.from_id, constraint.to_id


def holds(constraint: Judged) -> bool:
    """Whether it holds poses itself: no neighbour, no closure by laser that nobody judged."""
    by_hand = any(verdict.judge is Judge.PERSON for verdict in constraint.verdicts)
    scanned = isinstance(constraint.source, ScanMatch) and not by_hand
    moved = constraint.kind is ConstraintKind.NEIGHBOUR
    return constraint.accepted and not (scanned or moved)
