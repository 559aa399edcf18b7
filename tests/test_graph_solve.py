"""Robust solving of constraints: true ones kept, false ones rejected with a reason."""

from __future__ import annotations

import numpy as np
import pytest

from mapmyworld.geometry.planar import information_from_planar, planar_to_matrix
from mapmyworld.geometry.rigid import between, se3_exp
from mapmyworld.graph.solved_graph import component_losses, solve
from mapmyworld.types import ConstraintKind, Judged
from mapmyworld.types.wording import reason_of


def square_walk(rounds: int = 3, side: int = 10) -> np.ndarray:
    """True poses (N, 4, 4) of a robot that walks around a square, a metre a step."""
    poses, pose = [], np.zeros(3)
    for k in range(rounds * 4 * side):
        poses.append(pose.copy())
        pose = pose + np.array([np.cos(pose[2]), np.sin(pose[2]), 0.0])
        if k % side == side - 1:
            pose[2] += np.pi / 2
    return planar_to_matrix(np.array(poses))


def noisy_constraints(truth: np.ndarray, rng: np.random.Generator) -> list[Judged]:
    """Odometry between neighbours and closures one round apart, with true covariances."""
    sigma = np.array([0.02, 0.02, 0.01])
    information = information_from_planar(np.diag(sigma**-2))
    made = []
    count = len(truth)
    pairs = [(k, k + 1, ConstraintKind.NEIGHBOUR) for k in range(count - 1)]
    pairs += [(k, k + 40, ConstraintKind.LOOP_CLOSURE) for k in range(0, count - 40, 3)]
    for a, b, kind in pairs:
        noise = np.zeros(6)
        noise[[3, 4, 2]] = rng.normal(size=3) * sigma
        motion = between(truth[a], truth[b]) @ se3_exp(noise)
        made.append(Judged(a + 1, b + 1, kind, motion, information))
    return made


def false_closures(count: int, number: int, rng: np.random.Generator) -> list[Judged]:
    information = information_from_planar(np.diag([2500.0, 2500.0, 1e4]))
    made = []
    for _ in range(number):
        a, b = rng.choice(count, 2, replace=False)
        motion = planar_to_matrix(rng.uniform([-2, -2, -3], [2, 2, 3]))
        made.append(
            Judged(int(a) + 1, int(b) + 1, ConstraintKind.LOOP_CLOSURE, motion, information)
        )
    return made


def test_false_closures_are_rejected_with_a_reason_and_true_ones_kept():
    rng = np.random.default_rng(1)
    truth = square_walk()
    true = noisy_constraints(truth, rng)
    false = false_closures(len(truth), 30, rng)
    ids = np.arange(1, len(truth) + 1)
    start = np.tile(np.eye(4), (len(truth), 1, 1))
    solved = solve(ids, start, true + false, planar=True)
    assert all(c.accepted for c in solved.constraints[: len(true)])
    rejected = solved.constraints[len(true) :]
    assert not any(c.accepted for c in rejected)
    assert all("sigma" in reason_of(c) for c in rejected)
    error = between(truth, solved.poses.map_from_node)[:, :2, 3]
    assert np.abs(error).max() < 0.25


def test_parts_without_a_link_are_solved_apart():
    rng = np.random.default_rng(2)
    truth = square_walk(rounds=2)
    made = [c for c in noisy_constraints(truth, rng) if not c.from_id <= 50 < c.to_id]
    ids = np.arange(1, len(truth) + 1)
    solved = solve(ids, truth, made, planar=True)
    assert solved.component.tolist() == [0] * 50 + [1] * 30
    assert component_losses(int(solved.component.max()) + 1) == [
        "The graph has 2 components that no constraint connects."
    ]
    assert np.allclose(solved.poses.map_from_node[50], truth[50])


def test_a_constraint_without_sense_is_named_and_the_rest_solved():
    rng = np.random.default_rng(3)
    truth = square_walk(rounds=2)
    made = noisy_constraints(truth, rng)
    broken = Judged(3, 9, ConstraintKind.LOOP_CLOSURE, np.full((4, 4), np.nan), np.eye(6))
    nowhere = Judged(3, 999, ConstraintKind.LOOP_CLOSURE, np.eye(4), np.eye(6))
    solved = solve(np.arange(1, 81), truth, [*made, broken, nowhere], planar=True)
    assert [reason_of(c) for c in solved.constraints[-2:]] == [
        "cannot be used: its measurement is not a number",
        "cannot be used: node 999 does not exist",
    ]
    assert all(c.accepted for c in solved.constraints[:-2])


@pytest.mark.parametrize(
    ("information", "word"),
    [
        (np.eye(6) + np.diag(np.ones(5), 1), "is not symmetric"),
        (np.diag([1.0, 1, 1, 1, 1, -1]), "is not positive definite"),
        (np.zeros((6, 6)), "is not positive definite"),
        (np.full((6, 6), np.nan), "is not a number"),
    ],
)
def test_information_that_is_none_is_named_and_the_rest_solved(information, word):
    truth = square_walk(rounds=2)
    made = noisy_constraints(truth, np.random.default_rng(3))
    broken = Judged(3, 9, ConstraintKind.LOOP_CLOSURE, np.eye(4), information)
    solved = solve(np.arange(1, 81), truth, [*made, broken], planar=True)
    assert word in reason_of(solved.constraints[-1])
    assert all(c.accepted for c in solved.constraints[:-1])
