"""What was judged of a constraint: by whom, why, and by which numbers."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from enum import StrEnum


class Judge(StrEnum):
    """Who judges, in the order in which they do."""

    LASER = "laser"
    CAMERA = "camera"
    PERSON = "person"
    GRAPH = "graph"
    ALIGNMENT = "alignment"
    """The poses after the joint alignment of all scans."""


class Why(StrEnum):
    """The ground of a verdict, in a few words; `wording` says it with its numbers."""

    SCANS_ALIGNED = "scans aligned"
    NOTHING_IN_COMMON = "nothing in common"
    LITTLE_EVIDENCE = "little evidence"
    AMBIGUOUS_POSE = "ambiguous: another pose"
    NOT_CONVERGED = "not converged"
    DEGENERATE = "degenerate"
    AMBIGUOUS_PLACE = "ambiguous: another place"
    IMAGES_AGREE = "images agree"
    FEW_INLIERS = "few matches agree"
    LOW_SHARE = "low share of matches agrees"
    UNCERTAIN_TRANSLATION = "uncertain translation"
    UNCERTAIN_ROTATION = "uncertain rotation"
    MOTION_CONTRADICTS = "contradicts the tracked motion"
    AMBIGUOUS_VIEW = "ambiguous: same view elsewhere"
    MARKER_CORNERS = "corners of a marker"
    CORRECTED = "corrected by images"
    REFUTED = "refuted by scans"
    DOUBTED = "doubted by scans"
    FAULTS = "faults elsewhere"
    CONFIRMED = "confirmed by closures"
    ACCEPTED_BY_HAND = "accepted by hand"
    REJECTED_BY_HAND = "rejected by hand"
    UNUSABLE = "cannot be used"
    FITS = "fits the graph"
    UNSUPPORTED = "nothing supports it"
    CONTRADICTS = "contradicts the rest of the graph"
    MISSES = "misses the rest of the graph"
    MISSES_ALIGNED = "misses the refined poses"
    MEASURED_ANEW = "measured anew"
    CARRIED_OVER = "carried over"


SUPERSEDING = frozenset(
    {
        Why.CORRECTED,
        Why.REFUTED,
        Why.DOUBTED,
        Why.FAULTS,
        Why.CONFIRMED,
        Why.MEASURED_ANEW,
        Why.CARRIED_OVER,
    }
)
"""Grounds on which a constraint gives way to another of the same, which is kept as well."""


@dataclass(frozen=True, slots=True)
class Verdict:
    """One judgement; of several the last one counts."""

    judge: Judge
    accepted: bool
    why: Why
    numbers: Mapping[str, float] = field(default_factory=dict)
    """Measured values, and the limits they met or missed."""
    note: str = ""
    """What a person gave as reason, or what makes a constraint unusable."""
