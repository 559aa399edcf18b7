"""Wheels checked by images: wrong radii, wrong tracks and slips are reported as they are."""

from __future__ import annotations

from dataclasses import replace
from functools import reduce
from itertools import pairwise

import numpy as np
import pytest
from sample_verdicts import REJECTED

from mapmyworld.config import Config
from mapmyworld.geometry.planar import matrix_to_planar, planar_to_matrix
from mapmyworld.geometry.rigid import between
from mapmyworld.places.drift import Drift
from mapmyworld.places.wheel_check import check_wheels, corrected
from mapmyworld.types import (
    ConstraintKind,
    ImageMatch,
    Judge,
    Judged,
    Node,
    Odometry,
    Verdict,
    Why,
)


def drive(
    distance_share: float, turn_share: float, slip: float, twist: float = 0.0
) -> tuple[list[Node], list[Judged]]:
    """A curved drive as images see it, and as wheels measure it that err by these shares."""
    random = np.random.default_rng(0)
    odometry, truth = np.eye(4), np.eye(4)
    nodes, seen = [Node(1, 0, 0, odometry, odometry)], []
    for k in range(1, 200):
        way, turn = 0.1, 0.08 * np.sin(0.1 * k)
        reported = [way / (1 + distance_share), 0.0, turn / (1 + turn_share)]
        if k == 120:
            reported[0] += slip
            reported[2] += twist
        odometry = odometry @ planar_to_matrix(np.array(reported))
        noise = random.normal(size=3) * [0.001, 0.001, 0.0005]
        truth = truth @ planar_to_matrix(np.array([way, 0.0, turn]) + noise)
        nodes.append(Node(k + 1, 0, k * 10**9, odometry, truth))
        motion = between(nodes[-2].tracked_from_base, truth)
        kind = ConstraintKind.PROXIMITY
        seen.append(Judged(k, k + 1, kind, motion, 1e6 * np.eye(6), ImageMatch(steps=1)))
    return nodes, seen


@pytest.mark.parametrize("distance", [-0.03, 0.0, 0.02])
@pytest.mark.parametrize("turn", [-0.05, 0.0, 0.04])
def test_wrong_wheels_are_measured(distance: float, turn: float) -> None:
    check = check_wheels(*drive(distance, turn, 0.0))
    assert check is not None
    assert check.source.distance_share == pytest.approx(distance, abs=0.003)
    assert check.source.turn_share == pytest.approx(turn, abs=0.004)
    assert len(check.slips) == 0
    assert f"distance {check.source.distance_share:+.1%}" in check.lines()[0]


def test_the_noise_of_wheels_is_measured() -> None:
    """A millimetre and half a milliradian, of motions of 0.1 m and 0.05 rad."""
    check = check_wheels(*drive(0.0, 0.0, 0.0))
    assert check is not None
    sigmas = np.sqrt(np.median(check.motions.variances(), axis=0))
    np.testing.assert_allclose(sigmas, [0.001, 0.001, 0.0005], rtol=0.25)


def test_a_slip_is_found_where_it_was() -> None:
    check = check_wheels(*drive(0.01, 0.02, 0.05))
    assert check is not None
    assert check.slips.tolist() == [119]
    assert np.hypot(*check.missed[119, :2]) == pytest.approx(0.05, abs=0.005)
    assert "at 120.00 s" in check.lines()[1]
    assert check.source.distance_share == pytest.approx(0.01, abs=0.003)


def test_how_far_a_turn_is_off_is_reported_as_it_is() -> None:
    check = check_wheels(*drive(0.0, 0.0, 0.0, twist=0.06))
    assert check is not None
    assert check.slips.tolist() == [119]
    assert abs(check.missed[119, 2]) == pytest.approx(0.06, abs=0.003)


def test_a_motion_that_images_contradict_is_as_uncertain_as_it_is_off() -> None:
    nodes, seen = drive(0.0, 0.0, 0.05)
    check, steps = check_wheels(nodes, seen), reported(nodes)
    assert check is not None
    mended = corrected(nodes, steps, check)[len(steps) :]
    slipped, other = (np.linalg.inv(mended[k].information) for k in (119, 20))
    assert np.sqrt(slipped[3, 3]) == pytest.approx(0.05, abs=0.005)
    assert np.sqrt(other[3, 3]) == pytest.approx(0.001, rel=0.3)


def test_what_images_measure_too_vaguely_for_a_closure_joins_the_wheels() -> None:
    """A motion that wheels know to a millimetre, and images twice as well."""
    nodes, seen = drive(0.0, 0.0, 0.0)
    vague = Verdict(Judge.CAMERA, False, Why.UNCERTAIN_ROTATION)
    seen[120] = replace(seen[120].judged(vague), information=4e6 * np.eye(6))
    check, steps = check_wheels(nodes, seen), reported(nodes)
    assert check is not None
    assert check.seen == len(seen) - 1
    joined, alone = corrected(nodes, steps, check)[len(steps) :][120], check.motions.measured()[120]
    share = 1.0 - joined.information[3, 3] ** -1 * 1e6
    assert share == pytest.approx(0.8, abs=0.05)
    found = matrix_to_planar(seen[120].i_from_j) - alone
    moved = matrix_to_planar(joined.i_from_j) - alone
    np.testing.assert_allclose(moved[:2], 0.8 * found[:2], atol=0.1 * np.abs(found[:2]).max())


def test_a_few_images_indicate_nothing() -> None:
    nodes, seen = drive(0.1, 0.1, 0.0)
    assert check_wheels(nodes, seen[:10]) is None


def test_unequal_wheels_are_measured_and_taken_out() -> None:
    """They turn the robot by a degree and a half a metre, also straight on."""
    nodes, seen = drive(0.0, 0.0, 0.0)
    bent, bend = [np.eye(4)], np.radians(1.5)
    for a, b in pairwise(nodes):
        step = matrix_to_planar(between(a.odom_from_base, b.odom_from_base))
        bent.append(bent[-1] @ planar_to_matrix(step - [0.0, 0.0, bend * step[0]]))
    nodes = [replace(n, odom_from_base=pose) for n, pose in zip(nodes, bent, strict=True)]
    check = check_wheels(nodes, seen)
    assert check is not None
    assert check.source.degrees_per_m == pytest.approx(1.5, rel=0.03)
    assert len(check.slips) == 0
    steps = reported(nodes)
    mended = [c for c in corrected(nodes, steps, check) if c.accepted]
    truth = between(nodes[0].tracked_from_base, nodes[-1].tracked_from_base)
    errors = [matrix_to_planar(between(truth, end_of(some))) for some in (steps, mended)]
    assert abs(errors[1][2]) < 0.1 * abs(errors[0][2])


def test_refused_pairs_and_longer_steps_do_not_count() -> None:
    nodes, seen = drive(0.0, 0.0, 0.0)
    refused = [c.judged(REJECTED) for c in seen]
    longer = [replace(c, source=ImageMatch(steps=2)) for c in seen]
    assert check_wheels(nodes, [*refused, *longer]) is None


def reported(nodes: list[Node]) -> list[Judged]:
    """The motions from node to node as wheels reported them."""
    kind = ConstraintKind.NEIGHBOUR
    steps = [between(a.odom_from_base, b.odom_from_base) for a, b in pairwise(nodes)]
    return [
        Judged(k, k + 1, kind, step, np.eye(6), Odometry()) for k, step in enumerate(steps, start=1)
    ]


def end_of(steps: list[Judged]) -> np.ndarray:
    """Where a path of these steps ends (4, 4)."""
    return reduce(np.matmul, [c.i_from_j for c in steps])


@pytest.mark.parametrize(("distance", "turn"), [(-0.05, -0.05), (0.0, 0.04), (0.03, 0.0)])
def test_what_all_motions_share_in_error_is_taken_out(distance: float, turn: float) -> None:
    nodes, seen = drive(distance, turn, 0.0)
    check, wheels = check_wheels(nodes, seen), reported(nodes)
    assert check is not None
    mended = corrected(nodes, [*wheels, *seen], check)
    count = len(wheels)
    assert all(c.is_superseded for c in mended[:count])
    assert mended[count:-count] == seen
    true = nodes[-1].tracked_from_base
    before, after = (np.linalg.norm((end_of(s) - true)[:3, 3]) for s in (wheels, mended[-count:]))
    assert after < min(0.06, 0.3 * before)


def test_a_closure_that_wheels_of_a_wrong_track_contradict_is_believed() -> None:
    """Three times around: each quarter of a turn reported five hundredths too large adds up."""
    straight, turn = [0.2, 0.0, 0.0], [0.0, 0.0, np.pi / 20.0]
    steps = np.array(12 * (20 * [straight] + 10 * [turn]))
    truth, tracked = [np.eye(4)], [np.eye(4)]
    for step in steps:
        truth.append(truth[-1] @ planar_to_matrix(step))
        tracked.append(tracked[-1] @ planar_to_matrix(step * [1.0, 1.0, 1.05]))
    nodes = [Node(k + 1, 0, k * 10**9, pose, pose) for k, pose in enumerate(tracked)]
    drift = Drift(nodes, [replace(c, information=1e8 * np.eye(6)) for c in reported(nodes)])
    limit = Config().odometry.contradiction
    sigmas, _, radians = drift.excess(0, len(steps), between(truth[0], truth[-1]))
    assert radians > 0.9
    assert sigmas < limit
    elsewhere = planar_to_matrix(np.array([4.0, 0.0, 0.0]))
    assert drift.excess(0, 40, between(truth[0], truth[40] @ elsewhere))[0] > limit
