"""What holds the joint alignment of scans beside the scans themselves."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from sample_verdicts import REJECTED

from mapmyworld.alignment.joint_alignment import align_in_rounds
from mapmyworld.alignment.joint_system import NOTHING, Statements, joint_system, node_motions
from mapmyworld.api import Silent
from mapmyworld.config import Config
from mapmyworld.geometry.planar import between_planar, planar_to_matrix
from mapmyworld.registration.scan_matching import scan_set
from mapmyworld.types import (
    ConstraintKind,
    ImageMatch,
    Judge,
    Judged,
    Marker,
    Node,
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


AT = np.array([[0.3 * k, 0.1, 0.02 * k] for k in range(5)])
NODES = [
    Node(i, 1, i, planar_to_matrix(AT[k]), planar_to_matrix(AT[k]))
    for k, i in enumerate((5, 6, 7, 8))
]
CHOSEN = np.arange(4)


def test_scans_state_nothing_that_their_alignment_does_not_see() -> None:
    found = Statements.of(NODES, GIVEN)
    assert [c for c in GIVEN if c in found.constraints] == [GIVEN[k] for k in (2, 3, 5, 7)]
    assert found.landmarks == (-2,)
    assert found.concerns(NODES).tolist() == [0, 1, 2, 3]
    assert Statements.of(NODES, GIVEN[:1]).concerns(NODES).tolist() == []


def test_closures_and_statements_are_edges_of_one_system() -> None:
    stated, held = Statements.of(NODES, GIVEN), np.zeros(5, np.bool_)
    system, every = joint_system(NODES, CHOSEN, GIVEN, stated, AT, held, CHOSEN)
    ends = list(zip(system.tails.tolist(), system.heads.tolist(), strict=True))
    assert ends[:4] == [(1, 2), (0, 3), (2, 4), (5, 1)]  # four nodes, the landmark, the map
    assert ends[4:] == [(0, 2)]
    assert np.flatnonzero(system.free < 0).tolist() == [5]
    assert len(every) == 6


def test_closures_of_scans_that_are_left_out_tie_no_others() -> None:
    """They were carried along a lap or more of tracked motions, and stated to centimetres."""
    held, given = np.zeros(3, np.bool_), GIVEN[:2]
    for chosen, expected in ((CHOSEN[[0, 1, 3]], []), (CHOSEN[[0, 2, 3]], [(0, 1)])):
        system, _ = joint_system(NODES, chosen, given, NOTHING, AT[chosen], held, CHOSEN)
        assert list(zip(system.tails.tolist(), system.heads.tolist(), strict=True)) == expected


def test_headings_err_by_their_lever_arms_over_scans_that_are_left_out() -> None:
    """Ten motions of a metre, each known to 1 cm and 0.01 rad."""
    poses = planar_to_matrix(np.array([[1.0 * k, 0.0, 0.0] for k in range(11)]))
    nodes = [Node(k + 5, 1, k, pose, pose) for k, pose in enumerate(poses)]
    steps = [constraint(k, k + 1, ConstraintKind.NEIGHBOUR, ScanMatch()) for k in range(5, 15)]
    _, _, measured, information = node_motions(nodes, np.array([0, 10]), steps)
    np.testing.assert_allclose(measured, [[10.0, 0.0, 0.0]], atol=1e-9)
    (spread,) = np.linalg.inv(information)
    assert np.allclose(spread.diagonal(), [1e-3, 1e-3 + 1e-4 * sum(k * k for k in range(10)), 1e-3])


def test_landmarks_move_with_what_sees_them_and_priors_move_the_map() -> None:
    """Without a scan: statements alone say where everything is."""
    vague = [replace(n, session=n.id) for n in NODES]  # so that no motion ties them
    stated, landmark = (
        Statements.of(vague, GIVEN[2:]),
        Poses(np.array([-2]), planar_to_matrix(AT[4:])),
    )
    assert np.allclose(stated.places_of(landmark), AT[4:])
    system, every = joint_system(
        vague, CHOSEN, GIVEN[2:3], stated, AT, np.zeros(5, np.bool_), CHOSEN
    )
    none = np.zeros((0, 2), np.int64)
    rest = (lambda _: none), Config(threads=1), Silent(), np.full(8, 0.1)
    solved = align_in_rounds(scan_set([]), system, every, *rest)
    prior, seen = solved.poses[1], between_planar(solved.poses[2], solved.poses[4])
    np.testing.assert_allclose(prior, [1.0, 0.0, 0.0], atol=1e-5)
    np.testing.assert_allclose(seen, [1.0, 0.0, 0.0], atol=1e-5)
    np.testing.assert_array_equal(solved.poses[5], 0.0)
