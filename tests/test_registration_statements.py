"""What holds the joint alignment of scans beside the scans themselves."""

from __future__ import annotations

import numpy as np
from sample_verdicts import REJECTED

from mapmyworld.config import Config
from mapmyworld.geometry.planar import between_planar, planar_to_matrix
from mapmyworld.registration.joint_alignment import align_jointly
from mapmyworld.registration.joint_statements import joined, statements_of
from mapmyworld.registration.scan_matching import scan_set
from mapmyworld.types import (
    ConstraintKind,
    ImageMatch,
    Judge,
    Judged,
    Marker,
    Person,
    Poses,
    ScanMatch,
    Verdict,
    Why,
)
from mapmyworld.types.sources import Source

LOOP = ConstraintKind.LOOP_CLOSURE
BY_HAND = Verdict(Judge.PERSON, True, Why.SCANS_ALIGNED, note="seen")
MARKER = Marker(7, 1.0, 0.5)


def constraint(a: int, b: int, kind: ConstraintKind, source: Source, *verdicts: Verdict) -> Judged:
    """From node `a` to `b`, a metre ahead."""
    ahead = planar_to_matrix(np.array([1.0, 0.0, 0.0]))
    return Judged(a, b, kind, ahead, 1e4 * np.eye(6), source, verdicts)


GIVEN = [
    constraint(5, 6, ConstraintKind.NEIGHBOUR, ScanMatch()),
    constraint(5, 7, LOOP, ScanMatch()),
    constraint(6, 7, LOOP, ScanMatch(), BY_HAND),
    constraint(5, 8, LOOP, ImageMatch()),
    constraint(5, 7, LOOP, ImageMatch(), REJECTED),
    constraint(7, -2, ConstraintKind.LANDMARK, MARKER),
    constraint(9, -3, ConstraintKind.LANDMARK, MARKER),  # node 9 has no scan
    constraint(6, 6, ConstraintKind.PRIOR, Person("prior", "surveyed")),
]


def test_scans_state_nothing_that_their_alignment_does_not_see() -> None:
    found = statements_of([5, 6, 7, 8], GIVEN)
    ends = list(zip(found.tails.tolist(), found.heads.tolist(), strict=True))
    assert ends == [(1, 2), (0, 3), (2, 4), (5, 1)]  # rows: four nodes, the landmark, the map
    assert found.landmarks.tolist() == [-2]
    assert found.stated.tolist() == [0, 1, 2, 3]
    assert found.places
    assert not statements_of([5, 6, 7, 8], GIVEN[:-1]).places


def test_landmarks_move_with_what_sees_them_and_priors_move_the_map() -> None:
    """Without a scan: statements alone say where everything is."""
    ids, made = [5, 6, 7, 8], GIVEN[1:]
    found = statements_of(ids, made)
    at = np.array([[0.3 * k, 0.1, 0.02 * k] for k in range(5)])
    every = np.array([*ids, -2])
    others = found.others(Poses(every, planar_to_matrix(at)))
    chosen = np.arange(4)
    still = statements_of(ids, []).among(chosen)
    motions = joined(still, found.among(chosen))
    held = np.arange(6) == 5
    start = np.concatenate([at[:4], others])
    none = np.zeros((0, 2), np.int64)
    solved = align_jointly(
        scan_set([]), start, none, motions, [0.1] * 8, Config().registration, 1, held=held
    )
    prior, seen = solved.poses[1], between_planar(solved.poses[2], solved.poses[4])
    np.testing.assert_allclose(prior, [1.0, 0.0, 0.0], atol=1e-5)
    np.testing.assert_allclose(seen, [1.0, 0.0, 0.0], atol=1e-5)
    np.testing.assert_array_equal(solved.poses[5], 0.0)
