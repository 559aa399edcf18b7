"""The pose graph's parts: registrations, constraints and what was judged of them, poses."""

from __future__ import annotations

from dataclasses import dataclass, replace
from enum import StrEnum
from typing import Self

import numpy as np
from numpy.typing import NDArray

from mapmyworld.types.rows import Rows
from mapmyworld.types.sources import GIVEN, RELOCALISED, LaserTracking, Person, Source
from mapmyworld.types.verdicts import SUPERSEDING, Judge, Verdict


@dataclass(frozen=True, slots=True, eq=False)
class Registration:
    """Two observations aligned, or the reason why not."""

    a_from_b: NDArray[np.float64]
    """(4, 4)."""
    information: NDArray[np.float64]
    """(6, 6) inverse covariance of the right perturbation, rotation first."""
    verdict: Verdict
    """Whether it can be used."""
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
# Kinds of one node alone, in the map's frame: `to_id == from_id`, and pictures draw no line.
OF_ONE_NODE = frozenset({ConstraintKind.PRIOR})
# Kinds that say: we have been here before.
CLOSURES = frozenset({ConstraintKind.LOOP_CLOSURE, ConstraintKind.PROXIMITY})
_JUDGES = tuple(Judge)


@dataclass(frozen=True, slots=True, eq=False)
class Constraint:
    """A measured relative pose between two nodes; what becomes of it changes nothing in it."""

    from_id: int
    to_id: int
    """A landmark's id is negative; a prior has `to_id == from_id` and measures map_from_node."""
    kind: ConstraintKind
    i_from_j: NDArray[np.float64]
    """(4, 4): pose of `to` in the frame of `from`."""
    information: NDArray[np.float64]
    """(6, 6), rotation first."""
    source: Source = GIVEN
    """What measured it."""

    @property
    def is_tracking_loss(self) -> bool:
        """Whether tracking was lost between the two nodes, and with it how they lie."""
        return isinstance(self.source, LaserTracking) and self.source.lost

    @property
    def is_relocalised(self) -> bool:
        """Whether the place afterwards measured the motion, and not tracking."""
        return isinstance(self.source, LaserTracking) and self.source.state == RELOCALISED

    @property
    def is_unmatched(self) -> bool:
        """Whether scans fitted nothing on the way, so that odometry alone measured the motion."""
        return isinstance(self.source, LaserTracking) and self.source.state == "odometry only"

    @property
    def contradicts_odometry(self) -> bool:
        """Whether scans matched elsewhere than odometry had it, which was ignored there."""
        return isinstance(self.source, LaserTracking) and self.source.state == "odometry ignored"

    @property
    def is_doubted(self) -> bool:
        """Whether it is odometry that scans afterwards put in doubt."""
        return isinstance(self.source, LaserTracking) and self.source.doubted

    @property
    def interrupts_tracking(self) -> bool:
        """Whether poses before and after it may not follow each other as they were tracked."""
        refuted = self.is_relocalised or self.contradicts_odometry or self.is_doubted
        return self.is_tracking_loss or refuted


@dataclass(frozen=True, slots=True, eq=False)
class Judged(Constraint):
    """A constraint with the verdicts on it, in their order; the last one counts."""

    verdicts: tuple[Verdict, ...] = ()

    @property
    def accepted(self) -> bool:
        """Whether it is believed, as it is where nobody judged it."""
        return not self.verdicts or self.verdicts[-1].accepted

    @property
    def is_superseded(self) -> bool:
        """Whether a better measurement of the same took its place."""
        return bool(self.verdicts) and not self.accepted and self.verdicts[-1].why in SUPERSEDING

    @property
    def is_by_hand(self) -> bool:
        """Whether a person made it or judged it."""
        judges = (verdict.judge for verdict in self.verdicts)
        return isinstance(self.source, Person) or Judge.PERSON in judges

    def judged(self, *verdicts: Verdict) -> Self:
        """The same with further verdicts."""
        return replace(self, verdicts=(*self.verdicts, *verdicts))

    def before(self, judge: Judge) -> Self:
        """The same without the verdicts of this judge and of those who judge later."""
        later = _JUDGES[_JUDGES.index(judge) :]
        kept = tuple(verdict for verdict in self.verdicts if verdict.judge not in later)
        return self if len(kept) == len(self.verdicts) else replace(self, verdicts=kept)


@dataclass(frozen=True, slots=True, eq=False)
class Poses(Rows):
    """Solved poses of nodes (positive ids) and landmarks (negative ids)."""

    ids: NDArray[np.int64]
    """(N,) ascending by absolute value within each kind, nodes first."""
    map_from_node: NDArray[np.float64]
    """(N, 4, 4)."""
    covariances: NDArray[np.float64] | None = None
    """(N, 6, 6), rotation first, in each node's own frame; relative to the component's first node,
    or to the map's frame where a prior ties the component to it."""
