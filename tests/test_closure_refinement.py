"""Closures judged by the final poses: a turned one is measured anew, an untrue one rejected."""

from __future__ import annotations

import numpy as np
import pytest
from laser_rooms import WALLS, cast
from numpy.typing import NDArray

from mapmyworld.alignment.closure_refinement import refine_closures
from mapmyworld.config import Config
from mapmyworld.geometry import Array, Index
from mapmyworld.geometry.planar import (
    between_planar,
    compose_planar,
    matrix_to_planar,
    planar_to_matrix,
)
from mapmyworld.places.laser_closures import OPEN
from mapmyworld.places.laser_nodes import NodeScans
from mapmyworld.registration.scan_matching import prepare_scans, scan_set
from mapmyworld.types import (
    ConstraintKind,
    ImageMatch,
    Judge,
    Judged,
    Node,
    Poses,
    ScanMatch,
    Source,
    Verdict,
    Why,
)  # fmt: skip
from mapmyworld.types.wording import reason_of

CONFIG = Config()
THERE = np.stack([np.linspace(-2.5, 2.3, 49), np.full(49, 0.5), np.zeros(49)], axis=-1)
TRUTH = np.concatenate([THERE, THERE[::-1] + np.array([0.0, 0.0, np.pi]), THERE])
A, B = 10, 108  # one place on the way there and the second time


def visits(moved: float) -> tuple[NodeScans, Poses]:
    """Two visits; at the second the walls stand `moved` metres further along x."""
    shifted = WALLS + np.array([moved, 0.0, moved, 0.0])
    walls = [WALLS if k < 98 else shifted for k in range(len(TRUTH))]
    seen = [cast(pose, walls[k], k) for k, pose in enumerate(TRUTH)]
    poses = planar_to_matrix(TRUTH)
    nodes = [Node(k + 1, 0, k * 10**8, pose, pose) for k, pose in enumerate(poses)]
    made = prepare_scans(seen, CONFIG.registration)
    ids = np.arange(1, len(TRUTH) + 1)
    scans = scan_set([made.one(k) for k in range(len(made))])
    never = np.zeros(len(nodes), np.bool_)
    loaded = NodeScans(nodes, scans, never, ~never, never)
    return loaded, Poses(ids, poses, None)


def nothing_known(pairs: Index) -> Array:
    """The poses leave open how their nodes lie beside each other."""
    return np.full(len(pairs), np.inf)


def closure(error: NDArray[np.float64], kind: ConstraintKind, by: Source) -> Judged:
    measured = compose_planar(between_planar(TRUTH[A], TRUTH[B]), error)
    return Judged(
        from_id=A + 1, to_id=B + 1, kind=kind, i_from_j=planar_to_matrix(measured),
        information=np.eye(6), source=by,
    )  # fmt: skip


@pytest.fixture(scope="module")
def same() -> tuple[NodeScans, Poses]:
    return visits(0.0)


def test_a_turned_closure_is_measured_anew(same: tuple[NodeScans, Poses]) -> None:
    turned = closure(
        np.array([0.01, 0.0, np.radians(2.0)]), ConstraintKind.LOOP_CLOSURE, ScanMatch(score=0.8)
    )
    old, anew = refine_closures([turned], same[1], nothing_known, CONFIG, same[0])
    error = between_planar(between_planar(TRUTH[A], TRUTH[B]), matrix_to_planar(anew.i_from_j))
    assert anew.accepted
    assert np.hypot(*error[:2]) < 0.02
    assert abs(error[2]) < np.radians(0.3)
    assert "anew" in reason_of(anew)
    assert old.is_superseded
    np.testing.assert_array_equal(old.i_from_j, turned.i_from_j)


def test_closures_that_fit_or_come_from_elsewhere_stay(same: tuple[NodeScans, Poses]) -> None:
    good = closure(np.array([0.02, 0.01, 0.002]), ConstraintKind.PROXIMITY, ScanMatch(score=0.8))
    by_images = closure(np.array([0.4, 0.0, 0.1]), ConstraintKind.LOOP_CLOSURE, ImageMatch())
    turned = closure(np.array([0.4, 0.0, 0.1]), ConstraintKind.LOOP_CLOSURE, ScanMatch(score=0.8))
    by_hand = turned.judged(Verdict(Judge.PERSON, True, Why.ACCEPTED_BY_HAND))
    kept = refine_closures([good, by_images, by_hand], same[1], nothing_known, CONFIG, same[0])
    assert kept[0] is good
    assert kept[1] is by_images
    assert kept[2] is by_hand  # where it is not met, that is reported


def test_a_closure_that_the_final_poses_deny_does_not_stand() -> None:
    """Beside it stands what the same places measure from the final poses."""
    scans, poses = visits(0.6)
    false = closure(np.array([0.6, 0.0, 0.0]), ConstraintKind.LOOP_CLOSURE, ScanMatch(score=0.8))
    judged, anew = refine_closures([false], poses, nothing_known, CONFIG, scans)
    assert not judged.accepted
    error = between_planar(between_planar(TRUTH[A], TRUTH[B]), matrix_to_planar(anew.i_from_j))
    assert np.hypot(*error[:2]) < 0.02


def test_a_closure_that_nothing_measures_from_the_final_poses_is_rejected() -> None:
    scans, poses = visits(0.0)
    matrices = poses.map_from_node.copy()
    matrices[B - 10 :] = planar_to_matrix(np.array([0.0, 9.0, 0.0])) @ matrices[B - 10 :]
    true = closure(np.zeros(3), ConstraintKind.LOOP_CLOSURE, ScanMatch(score=0.8))
    (judged,) = refine_closures(
        [true], Poses(poses.ids, matrices, None), nothing_known, CONFIG, scans
    )
    assert not judged.accepted
    assert "contradicts the refined poses by 9.00 m" in reason_of(judged)


def test_a_closure_that_misses_the_final_poses_again_is_rejected() -> None:
    """Where the solution has both visits 0.2 m apart, what their scans measure stays off."""
    scans, poses = visits(0.0)
    matrices = poses.map_from_node.copy()
    matrices[B - 10 :] = planar_to_matrix(np.array([0.2, 0.0, 0.0])) @ matrices[B - 10 :]
    true = closure(np.zeros(3), ConstraintKind.LOOP_CLOSURE, ScanMatch(score=0.8))
    (judged,) = refine_closures(
        [true], Poses(poses.ids, matrices, None), nothing_known, CONFIG, scans
    )
    assert not judged.accepted
    assert "contradicts the refined poses by 0.20 m" in reason_of(judged)


@pytest.mark.parametrize("why", OPEN)
@pytest.mark.parametrize(
    ("sigma", "session", "expected"), [(0.02, 0, 1), (0.3, 0, 0), (0.02, 1, 0)]
)
def test_the_graph_decides_what_scans_leave_ambiguous(
    same: tuple[NodeScans, Poses], why: Why, sigma: float, session: int, expected: int
) -> None:
    """Where it knows both places better than other poses lie from these, of one session."""
    loaded, poses = same
    door = closure(np.array([2.0, 0.0, 0.0]), ConstraintKind.LOOP_CLOSURE, ScanMatch(score=0.8))
    refused = door.judged(Verdict(Judge.LASER, False, why))
    lost = loaded.lost.copy()
    lost[98] = session > 0  # before the second visit
    parted = loaded._replace(lost=lost)

    def known(pairs: Index) -> Array:
        return np.full(len(pairs), sigma)

    first, *anew = refine_closures([refused], poses, known, CONFIG, parted)
    assert not first.accepted
    assert len(anew) == expected
    for c in anew:
        assert c.accepted
        miss = matrix_to_planar(c.i_from_j) - between_planar(TRUTH[A], TRUTH[B])
        assert np.hypot(*miss[:2]) < 0.02
        assert len(refine_closures([first, c], poses, known, CONFIG, loaded)) == 2  # once
