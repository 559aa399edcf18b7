"""What two views indicate about each other: points that agree, less those that contradict."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from mapmyworld.geometry import Array, Index
from mapmyworld.geometry.planar import invert_planar
from mapmyworld.registration.likelihood_grid import LikelihoodGrid
from mapmyworld.registration.scan_matching import PreparedScan, scan_set
from mapmyworld.registration.scan_search import APART, continue_walls, judged_points, lie_on_a_line
from mapmyworld.registration.submaps import MARGIN, NATS, Submap, evidence_grid

FORTH = 0.3
"""Share of the evidence that a search must find in the points of the later place."""
_UNSEEN = 0.25  # weight of what one view knows of another and its second best does not
_FORTH_RATES = 0.93, 0.75
"""Share of a later place's points, of those in cells that are known, that lie on a surface of the
earlier one: where both are the same place, and where a corridor lies on another building's."""
_BACK_RATES = 0.80, 0.55  # the same of the earlier place's points; beams graze what is seen later
_KNOWN = 0.4  # share of a place's points that must lie where the other one was seen


@dataclass(frozen=True, slots=True, eq=False)
class Place:
    """What was seen around a pose, as points and as a grid, in one frame."""

    submap: Submap
    grid: LikelihoodGrid

    @staticmethod
    def of(submap: Submap) -> Place:
        """The place that a submap shows."""
        return Place(submap, evidence_grid(submap))

    @staticmethod
    def seen_by(scan: PreparedScan) -> Place:
        """What one scan shows, in its base frame."""
        return Place.of(Submap.of(scan_set([scan]), np.zeros((1, 3))))

    def agreement_with(self, other: Place, here_from_there: Array) -> Agreement:
        """What each reports about the other's points, at `here_from_there` (3,)."""
        back = invert_planar(here_from_there)
        return Agreement(
            judged_points(other.submap.scored, other.grid, self.grid, here_from_there),
            judged_points(self.submap.scored, self.grid, other.grid, back),
        )


@dataclass(frozen=True, slots=True, eq=False)
class Agreement:
    """Points of a later place in an earlier one, and the other way: 1, -1, or 0 where unseen or
    seen from the other side alone.
    """

    forth: Index
    """(P,) of the later place's points."""
    back: Index
    """(Q,) of the earlier place's points."""
    points: Array = field(default_factory=lambda: np.zeros((0, 2)))
    """(P, 2) of the later place, in its frame, where it matters which walls they are of."""

    @property
    def is_one_wall(self) -> bool:
        """Whether the later place's points that agree are about all of one wall."""
        return len(self.points) > 0 and lie_on_a_line(self.points[self.forth > 0])

    @property
    def evidence(self) -> float:
        """Points that agree, less those that contradict."""
        return float(self.forth.sum() + self.back.sum())

    @property
    def agreeing(self) -> float:
        """Share that agrees of the points, of either place, that the other one knows."""
        return self.hits / max(self.hits + self.contradictions, 1)

    @property
    def hits(self) -> int:
        """Points of either place that lie on what the other one saw."""
        return int(np.count_nonzero(self.forth > 0) + np.count_nonzero(self.back > 0))

    @property
    def known(self) -> float:
        """Share of the later place's points that lie where the earlier one was seen."""
        return np.count_nonzero(self.forth) / max(len(self.forth), 1)

    @property
    def log_odds(self) -> float:
        """Nats by which this is the same place rather than another one like those seen.

        Zero where the place lies mostly outside of what the other map saw, or shares one wall with
        it: along a wall anything fits.
        """
        return 0.0 if self.known < _KNOWN or self.is_one_wall else self.known_odds

    @property
    def known_odds(self) -> float:
        """The same of what is known of it, however little that is."""
        return _log_odds(self.forth, _FORTH_RATES) + _log_odds(self.back, _BACK_RATES)

    def beyond(self, second_best: Agreement) -> float:
        """Evidence beyond that of a second best for the same later place.

        What only one of them saw counts a quarter: it may well look like what both know, as where
        equal doors follow each other.
        """
        known = (self.forth != 0) & (second_best.forth != 0)
        apart = (self.forth - second_best.forth) * np.where(known, 1.0, _UNSEEN)
        back = _weighed(self.back) - _weighed(second_best.back)
        return float(apart.sum() + back)

    def refutes(self, other: Agreement) -> float:
        """Points by which all that is known speaks for this and against another pose of the same
        later place.

        Contradictions count in full. What agrees at one of the poses and is unseen at the other
        counts a quarter, and nothing where it only closes a room: walls that go on, and one more.
        """
        known = (self.forth != 0) & (other.forth != 0)
        agree = np.count_nonzero(self.forth[known] > 0) - np.count_nonzero(other.forth[known] > 0)
        alone = self._alone(other) - other._alone(self)
        return float(agree + other.contradictions - self.contradictions + _UNSEEN * alone)

    def _alone(self, other: Agreement) -> int:
        """Points that agree at this pose alone; none where they only close a room."""
        mine, shared = ((self.forth > 0) & seen for seen in (other.forth == 0, other.forth != 0))
        new = self.points[mine]
        if lie_on_a_line(new[~continue_walls(new, self.points[shared])]):
            return 0
        back = int(np.count_nonzero(self.back > 0)) - int(np.count_nonzero(other.back > 0))
        return len(new) + max(back, 0)

    @property
    def contradictions(self) -> int:
        """Points of either place that lie where beams of the other one passed."""
        return int(np.count_nonzero(self.forth < 0) + np.count_nonzero(self.back < 0))


@dataclass(frozen=True, slots=True, eq=False)
class Hypothesis:
    """A later place at one of the poses that are compared."""

    agreement: Agreement
    prior: float
    """Log density, in nats, of what leads there, less that where it is largest."""

    def beyond(self, other: Hypothesis, size: int = 1) -> float:
        """Points by which this pose is likelier than another one, of submaps of this size."""
        return self.agreement.beyond(other.agreement) + (self.prior - other.prior) * size / NATS


def _log_odds(judged: Index, rates: tuple[float, float]) -> float:
    hits, misses = np.count_nonzero(judged > 0), np.count_nonzero(judged < 0)
    same, other = rates
    return float(hits * np.log(same / other) + misses * np.log((1.0 - same) / (1.0 - other)))


def _weighed(back: Index) -> float:
    """Contradictions in full, agreement by a quarter."""
    return float(_UNSEEN * np.count_nonzero(back > 0) - np.count_nonzero(back < 0))


def needed_evidence(distance: float, angle: float) -> float:
    """Points from which the best pose of a window (m and rad to each side) is no chance."""
    return chance(distance, angle) + MARGIN


def chance(distance: float, angle: float) -> float:
    """Points that the best pose of a window (m and rad to each side) has by chance.

    The evidence of a false pose falls off exponentially, and each distinct pose is one try.
    """
    tries = (1.0 + 2.0 * distance / APART[0]) ** 2 * (1.0 + 2.0 * angle / APART[1])
    return float(np.log(tries) / NATS)
