"""Wheels checked by images: wrong radii, wrong tracks and slips are told as they are."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from mapmyworld.geometry.planar import planar_to_matrix
from mapmyworld.geometry.rigid import between
from mapmyworld.places.wheel_check import check_wheels
from mapmyworld.types import Constraint, ConstraintKind, Node


def drive(
    distance_share: float, turn_share: float, slip: float
) -> tuple[list[Node], list[Constraint]]:
    """A winding drive as images see it, and as wheels tell it that are wrong by these shares."""
    random = np.random.default_rng(0)
    odometry, truth = np.eye(4), np.eye(4)
    nodes, seen = [Node(1, 0, 0, odometry, odometry)], []
    for k in range(1, 200):
        way, turn = 0.1, 0.08 * np.sin(0.1 * k)
        told = [way / (1 + distance_share), 0.0, turn / (1 + turn_share)]
        if k == 120:
            told[0] += slip
        odometry = odometry @ planar_to_matrix(np.array(told))
        noise = random.normal(size=3) * [0.001, 0.001, 0.0005]
        truth = truth @ planar_to_matrix(np.array([way, 0.0, turn]) + noise)
        nodes.append(Node(k + 1, 0, k * 10**9, odometry, truth))
        motion = between(nodes[-2].tracked_from_base, truth)
        kind = ConstraintKind.PROXIMITY
        seen.append(Constraint(k, k + 1, kind, motion, np.eye(6), True, "", {"steps": 1.0}))
    return nodes, seen


@pytest.mark.parametrize("distance", [-0.03, 0.0, 0.02])
@pytest.mark.parametrize("turn", [-0.05, 0.0, 0.04])
def test_wrong_wheels_are_measured(distance: float, turn: float) -> None:
    check = check_wheels(*drive(distance, turn, 0.0))
    assert check is not None
    assert check.distance_share == pytest.approx(distance, abs=0.003)
    assert check.turn_share == pytest.approx(turn, abs=0.004)
    assert check.slips == ()
    assert f"distance {check.distance_share:+.1%}" in check.lines()[0]


def test_a_slip_is_found_where_it_was() -> None:
    check = check_wheels(*drive(0.01, 0.02, 0.05))
    assert check is not None
    assert [slip.stamp_ns for slip in check.slips] == [120 * 10**9]
    assert check.slips[0].metres == pytest.approx(0.05, abs=0.005)
    assert "at 120.00 s" in check.lines()[1]
    assert check.distance_share == pytest.approx(0.01, abs=0.003)


def test_a_few_images_tell_nothing() -> None:
    nodes, seen = drive(0.1, 0.1, 0.0)
    assert check_wheels(nodes, seen[:10]) is None


def test_refused_pairs_and_longer_steps_do_not_count() -> None:
    nodes, seen = drive(0.0, 0.0, 0.0)
    refused = [replace(c, accepted=False) for c in seen]
    longer = [replace(c, evidence={"steps": 2.0}) for c in seen]
    assert check_wheels(nodes, [*refused, *longer]) is None
