"""The pose graph's parts: registrations, constraints with their verdicts, solved poses."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from enum import StrEnum

import numpy as np
from numpy.typing import NDArray


@dataclass(frozen=True, slots=True, eq=False)
class Registration:
    """Two observations aligned, or the reason why not."""

    a_from_b: NDArray[np.float64]
    """(4, 4)."""
    information: NDArray[np.float64]
    """(6, 6) inverse covariance of the right perturbation, rotation first."""
    converged: bool
    reason: str
    """Why it is accepted or not, in words a user can act on."""
    inliers: int = 0
    overlap: float = 0.0
    """Share of b's observation that a explains, 0 to 1."""
    residual: float = float("inf")
    """Root mean square over inliers; metres (scans) or pixels (images)."""


class ConstraintKind(StrEnum):
    """Where a constraint comes from. The store, pictures and pages take a new member as it is."""

    NEIGHBOUR = "neighbour"
    LOOP_CLOSURE = "loop_closure"
    PROXIMITY = "proximity"
    LANDMARK = "landmark"
    PRIOR = "prior"
    USER = "user"


# Kinds that robust optimisation does not question: motion, and what a person has stated.
TRUSTED = frozenset({ConstraintKind.NEIGHBOUR, ConstraintKind.USER, ConstraintKind.PRIOR})
# Kinds that say: we have been here before.
CLOSURES = frozenset({ConstraintKind.LOOP_CLOSURE, ConstraintKind.PROXIMITY})
BREAK = "break"
"""Evidence of a neighbour constraint across which tracking was lost."""


@dataclass(frozen=True, slots=True, eq=False)
class Constraint:
    """A measured relative pose between two nodes, and what became of it."""

    from_id: int
    to_id: int
    """A landmark's id is negative; a prior has `to_id == from_id` and measures map_from_node."""
    kind: ConstraintKind
    from_from_to: NDArray[np.float64]
    """(4, 4): pose of `to` in the frame of `from`."""
    information: NDArray[np.float64]
    """(6, 6), rotation first."""
    accepted: bool = True
    reason: str = ""
    """Why it was accepted or rejected: measured values and the limits they met or missed."""
    evidence: Mapping[str, float] = field(default_factory=dict)
    """Named figures: score, overlap, inliers, residual before and after, sigmas, ..."""

    @property
    def is_break(self) -> bool:
        """Whether tracking was lost between the two nodes, and with it how they lie."""
        return BREAK in self.evidence and self.kind == ConstraintKind.NEIGHBOUR


@dataclass(frozen=True, slots=True, eq=False)
class Poses:
    """Solved poses of nodes (positive ids) and landmarks (negative ids)."""

    ids: NDArray[np.int64]
    """(N,) ascending by absolute value within each kind, nodes first."""
    map_from_node: NDArray[np.float64]
    """(N, 4, 4)."""
    covariances: NDArray[np.float64] | None = None
    """(N, 6, 6), rotation first, relative to the first node, in each node's own frame."""
