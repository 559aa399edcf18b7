"""What two views indicate about each other: points that agree, less those that contradict."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mapmyworld.geometry.planar import invert_planar
from mapmyworld.registration.scan_search import (
    MARGIN,
    NATS,
    LikelihoodGrid,
    Submap,
    evidence_grid,
    judged_points,
)

Array = NDArray[np.float64]
Index = NDArray[np.int64]
FORTH = 0.3
"""Share of the evidence that a search must find in the points of the later place."""
APART = 0.6, 0.3
"""Metres and radians between poses that are hypotheses of their own."""
_UNSEEN = 0.25  # weight of what one view knows of another and its second best does not


@dataclass(frozen=True, slots=True, eq=False)
class Place:
    """What was seen around a pose, as points and as a grid, in one frame."""

    submap: Submap
    grid: LikelihoodGrid

    @staticmethod
    def of(submap: Submap) -> Place:
        """The place that a submap shows."""
        return Place(submap, evidence_grid(submap))

    def agreement_with(self, other: Place, here_from_there: Array) -> Agreement:
        """What each reports about the other's points, at `here_from_there` (3,)."""
        back = invert_planar(here_from_there)
        return Agreement(
            judged_points(other.submap.points, self.grid, here_from_there),
            judged_points(self.submap.points, other.grid, back),
        )


@dataclass(frozen=True, slots=True, eq=False)
class Agreement:
    """Points of a later place in an earlier one, and the other way: 1, -1 or 0 where unseen."""

    forth: Index
    """(P,) of the later place's points."""
    back: Index
    """(Q,) of the earlier place's points."""

    @property
    def evidence(self) -> float:
        """Points that agree, less those that contradict."""
        return float(self.forth.sum() + self.back.sum())

    def beyond(self, second_best: Agreement) -> float:
        """Evidence beyond that of a second best for the same later place.

        What only one of them saw counts a quarter: it may well look like what both know, as where
        equal doors follow each other.
        """
        known = (self.forth != 0) & (second_best.forth != 0)
        apart = (self.forth - second_best.forth) * np.where(known, 1.0, _UNSEEN)
        back = _weighed(self.back) - _weighed(second_best.back)
        return float(apart.sum() + back)


def _weighed(back: Index) -> float:
    """Contradictions in full, agreement by a quarter."""
    return float(_UNSEEN * np.count_nonzero(back > 0) - np.count_nonzero(back < 0))


def needed_evidence(distance: float, angle: float) -> float:
    """Points from which the best pose of a window (m and rad to each side) is no chance.

    The evidence of a false pose falls off exponentially, and each distinct pose is one try.
    """
    tries = (1.0 + 2.0 * distance / APART[0]) ** 2 * (1.0 + 2.0 * angle / APART[1])
    return float(np.log(tries) / NATS + MARGIN)
