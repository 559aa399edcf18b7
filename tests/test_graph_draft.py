"""The graph solved roughly says what the whole one says, about."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray
from sample_verdicts import REJECTED

from mapmyworld.config import GraphConfig
from mapmyworld.geometry.planar import (
    between_planar,
    compose_planar,
    information_from_planar,
    matrix_to_planar,
    planar_to_matrix,
)
from mapmyworld.graph.chains import landmark_guesses, solve_by_chains
from mapmyworld.graph.solved_graph import solve
from mapmyworld.types import ConstraintKind, Judged, LaserTracking, Node

SIGMAS = np.array([0.01, 0.01, 0.004])
DRAFT = GraphConfig(covariances=False, certify=False, groups=False)


def drive(count: int = 120) -> tuple[NDArray[np.float64], list[Node], list[Judged]]:
    """True poses of three rounds on a circle, nodes that drifted, and their motions."""
    random = np.random.default_rng(3)
    angle = np.linspace(0, 6 * np.pi, count)
    truth = np.stack([4 * np.cos(angle), 4 * np.sin(angle), angle + np.pi / 2], axis=-1)
    steps = between_planar(truth[:-1], truth[1:]) + random.normal(size=(count - 1, 3)) * SIGMAS
    tracked = [truth[0]]
    for step in steps:
        tracked.append(compose_planar(tracked[-1], step))
    matrices = planar_to_matrix(np.stack(tracked))
    nodes = [Node(k + 1, 0, k, pose, pose) for k, pose in enumerate(matrices)]
    information = information_from_planar(np.diag(SIGMAS**-2.0))
    motions = [
        Judged(k + 1, k + 2, ConstraintKind.NEIGHBOUR, planar_to_matrix(step), information)
        for k, step in enumerate(steps)
    ]
    return truth, nodes, motions


def closure(truth: NDArray[np.float64], a: int, b: int) -> Judged:
    motion = planar_to_matrix(between_planar(truth[a], truth[b]))
    information = information_from_planar(np.diag([1e4, 1e4, 1e5]))
    return Judged(a + 1, b + 1, ConstraintKind.LOOP_CLOSURE, motion, information)


def test_a_draft_is_the_solution_but_for_its_linearisation() -> None:
    truth, nodes, motions = drive()
    true = [closure(truth, a, a + 80) for a in range(0, 40, 8)]
    false = replace(closure(truth, 3, 60), i_from_j=planar_to_matrix([2.0, 1.0, 0.3]))
    ids = [node.id for node in nodes]
    start = np.stack([node.tracked_from_base for node in nodes])
    whole = solve(ids, start, [*motions, *true, false], True)
    draft = solve_by_chains(nodes, [*motions, *true, false], True, DRAFT)
    np.testing.assert_array_equal(draft.poses.ids, whole.poses.ids)
    assert [c.accepted for c in draft.constraints] == [True] * (len(motions) + 5) + [False]
    drift = between_planar(matrix_to_planar(start), matrix_to_planar(whole.poses.map_from_node))
    miss = between_planar(
        matrix_to_planar(draft.poses.map_from_node), matrix_to_planar(whole.poses.map_from_node)
    )
    missed, drifted = np.hypot(*miss[:, :2].T), np.hypot(*drift[:, :2].T).max()
    ends = [i for c in true for i in (c.from_id - 1, c.to_id - 1)]
    assert missed[ends].max() < 0.02 * drifted
    assert missed.max() < 0.1 * drifted  # between two ends, their movements are shared out


@pytest.mark.parametrize(
    ("sigmas", "error"),
    [((1.0, 1.0, 2.0), (0.9, 0.3, 0.4)), ((0.01, 0.01, 1.0), (0.0, 0.0, 0.6))],
    ids=["unseen motion", "unseen turn"],
)
def test_what_solving_moved_lies_where_nothing_measured_the_motion(
    sigmas: tuple[float, ...], error: tuple[float, ...]
) -> None:
    """A round with one motion, after a blind one, that is as good as unknown: it is corrected."""
    angle = np.linspace(0.0, 2.0 * np.pi, 61)
    truth = np.stack([4 * np.cos(angle), 4 * np.sin(angle), angle + np.pi / 2], axis=-1)
    steps = between_planar(truth[:-1], truth[1:])
    steps[45] = compose_planar(steps[45], error)
    spread = np.tile(SIGMAS / 10.0, (60, 1))
    spread[45] = sigmas
    tracked = [truth[0]]
    for step in steps:
        tracked.append(compose_planar(tracked[-1], step))
    nodes = [Node(k + 1, 0, k, p, p) for k, p in enumerate(planar_to_matrix(np.stack(tracked)))]
    motions = [
        Judged(
            k + 1, k + 2, ConstraintKind.NEIGHBOUR, planar_to_matrix(step),
            information_from_planar(np.diag(sigma**-2.0)),
            LaserTracking("lost" if k == 44 else "matched", 0.0),
        )
        for k, (step, sigma) in enumerate(zip(steps, spread, strict=True))
    ]  # fmt: skip
    closed = [*motions, closure(truth, 0, 60)]
    for solved in (
        solve_by_chains(nodes, closed, True, DRAFT).poses,
        solve_by_chains(nodes, closed, True, GraphConfig()).poses,
    ):
        miss = between_planar(truth, matrix_to_planar(solved.map_from_node))
        assert np.hypot(*miss[:, :2].T).max() < 0.02
        assert np.abs(miss[:, 2]).max() < 0.01


def test_what_is_tied_by_motion_alone_keeps_its_place() -> None:
    _, nodes, motions = drive(40)
    nodes = [*nodes[:20], *(replace(node, session=1) for node in nodes[20:])]
    motions = [c for c in motions if c.from_id != 20]
    draft = solve_by_chains(nodes, motions, True, DRAFT)
    tracked = np.stack([node.tracked_from_base for node in nodes])
    np.testing.assert_allclose(draft.poses.map_from_node, tracked, atol=1e-9)
    assert all(c.accepted for c in draft.constraints)


def test_landmarks_are_guessed_where_they_are_seen_first() -> None:
    _, nodes, motions = drive(6)
    at = planar_to_matrix([1.0, 0.5, 0.0])
    seen = [
        Judged(k, -7, ConstraintKind.LANDMARK, at, information_from_planar(np.eye(3)))
        for k in (2, 4)
    ]
    starts = {node.id: node.tracked_from_base for node in nodes}
    guesses = landmark_guesses(starts, seen)
    np.testing.assert_allclose(guesses[-7], nodes[1].tracked_from_base @ at)
    draft = solve_by_chains(nodes, [*motions, *seen], True, DRAFT)
    assert draft.poses.ids.tolist() == [1, 2, 3, 4, 5, 6, -7]


def test_chains_say_what_the_whole_graph_says() -> None:
    """Poses, verdicts, reasons and covariances of all nodes; what came rejected stays as it was."""
    truth, nodes, motions = drive()
    closures = [closure(truth, a, a + 80) for a in range(0, 40, 8)]
    false = replace(closure(truth, 3, 60), i_from_j=planar_to_matrix([2.0, 1.0, 0.3]))
    refused = closure(truth, 9, 66).judged(REJECTED)
    strange = replace(motions[0], from_id=900, to_id=901)
    constraints = [*motions[:50], *closures, refused, *motions[50:], false, strange]
    ids = [node.id for node in nodes]
    start = np.stack([node.tracked_from_base for node in nodes])
    whole = solve(ids, start, constraints, True)
    chains = solve_by_chains(nodes, constraints, True, GraphConfig())
    np.testing.assert_array_equal(chains.poses.ids, whole.poses.ids)
    np.testing.assert_array_equal(chains.component, whole.component)
    assert [c.accepted for c in chains.constraints] == [c.accepted for c in whole.constraints]
    assert chains.constraints[55].verdicts == (REJECTED,)
    assert chains.constraints[-1].verdicts == whole.constraints[-1].verdicts
    np.testing.assert_allclose(chains.poses.map_from_node, whole.poses.map_from_node, atol=0.01)
    assert chains.poses.covariances is not None
    assert whole.poses.covariances is not None
    sigmas, true = (
        np.sqrt(np.diagonal(p.covariances, axis1=1, axis2=2)[1:, [3, 4, 2]])
        for p in (chains.poses, whole.poses)
    )
    assert np.median(sigmas / true) == pytest.approx(1.0, abs=0.05)
    assert (sigmas > 0.95 * true).all()


def test_a_chain_gives_its_error_to_the_motion_that_may_be_off() -> None:
    """As where scans put odometry in doubt: the other motions of the chain are well measured."""
    truth, nodes, motions = drive()
    nodes, motions = nodes[:12], motions[:11]
    wide = information_from_planar(np.diag([0.25, 0.25, 1.0]))
    turned = motions[5].i_from_j @ planar_to_matrix([0.1, 0.0, 0.3])
    motions[5] = replace(motions[5], i_from_j=turned, information=wide)
    constraints = [*motions, closure(truth, 0, 11)]
    start = np.stack([node.tracked_from_base for node in nodes])
    whole = solve([node.id for node in nodes], start, constraints, True, DRAFT)
    chains = solve_by_chains(nodes, constraints, True, DRAFT)
    np.testing.assert_allclose(chains.poses.map_from_node, whole.poses.map_from_node, atol=0.01)
