"""What is proven of a minimum: never a wrong one, and a bound that no arrangement undercuts."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from formats.graph_reading import read_graph
from mapmyworld.backend.certificate import Certificate, certify, proof_of
from mapmyworld.backend.convex_relaxation import (
    lower_weights,
    multiplied_out,
    relaxation_of,
    relaxation_poses,
)
from mapmyworld.backend.descent import descend
from mapmyworld.backend.residuals import retract
from mapmyworld.backend.system import edge_chi2, fit_of
from mapmyworld.config import GraphConfig
from mapmyworld.geometry.planar import between_planar, planar_to_matrix
from mapmyworld.geometry.rigid import se3_exp
from mapmyworld.graph.optimisation import optimise
from mapmyworld.graph.problem import Problem, problem_of
from mapmyworld.types.pose_graph import Edges, PoseGraph, no_priors, no_sightings
from tests.test_graph_optimise import ring

ALONE = GraphConfig(certify=False)


def circle(count: int, noise: float, seed: int) -> PoseGraph:
    """One round with a single closure, isotropic, and vertices all at the origin."""
    rng = np.random.default_rng(seed)
    angle = np.arange(count) * 2 * np.pi / count
    radius = count / (2 * np.pi)
    truth = np.column_stack([radius * np.cos(angle), radius * np.sin(angle), angle])
    tails, heads = np.arange(count), (np.arange(count) + 1) % count
    motion = between_planar(truth[tails], truth[heads])
    measured = retract(True, motion, noise * rng.normal(size=(count, 3)))
    information = np.tile(np.eye(3) / noise**2, (count, 1, 1))
    return PoseGraph(
        True,
        np.arange(count),
        np.zeros((count, 3)),
        Edges(tails, heads, measured, information, heads == tails + 1),
        landmarks=np.zeros((0, 2)),
        sightings=no_sightings(True),
        priors=no_priors(True),
    )


def mild(planar: bool) -> PoseGraph:
    """A ring whose information is full, and not very directional."""
    graph = ring(planar)
    weights = 0.03 * graph.edges.information + 100 * np.eye(3 if planar else 6)
    return replace(graph, edges=replace(graph.edges, information=weights))


def cost_at(problem: Problem, poses: np.ndarray) -> float:
    return 0.5 * float(edge_chi2(problem.system, poses).sum())


@pytest.mark.parametrize("planar", [True, False])
def test_no_arrangement_of_the_nodes_costs_less_than_the_bound(planar):
    """Random arrangements, far and near, of a graph with full information matrices."""
    solved = optimise(mild(planar), ALONE)
    problem = problem_of(solved.graph)
    bound = certify(problem.system, fit_of(problem.system, problem.guess)).lower_bound
    assert 0.0 < bound <= solved.cost * (1 + 1e-9)
    rng = np.random.default_rng(0)
    for size in (1e-3, 1e-2, 0.1, 1.0, 3.0):
        step = size * rng.normal(size=(len(problem.guess), 3 if planar else 6))
        assert cost_at(problem, retract(planar, problem.guess, step)) >= bound


@pytest.mark.parametrize("planar", [True, False])
def test_the_relaxation_never_costs_more_than_the_graph(planar):
    problem = problem_of(optimise(ring(planar), ALONE).graph)
    relaxation = relaxation_of(problem.system, fit_of(problem.system, problem.guess).residuals)
    rng = np.random.default_rng(1)
    for size in (0.0, 0.01, 0.3, 2.0):
        step = size * rng.normal(size=(len(problem.guess), 3 if planar else 6))
        poses = retract(planar, problem.guess, step)
        x = relaxation_poses(planar, poses)[relaxation.order]
        cost = 0.5 * float(np.sum(multiplied_out(relaxation.matrix, x) * x))
        assert cost <= cost_at(problem, poses) * (1 + 1e-9)


def test_the_weights_never_exceed_the_information():
    rng = np.random.default_rng(2)
    root = rng.normal(size=(40, 6, 6))
    information = root @ np.swapaxes(root, 1, 2) + 0.01 * np.eye(6)
    turn, tau = lower_weights(False, information, rng.normal(size=(40, 6)))
    less = np.zeros_like(information)
    less[:, :3, :3], less[:, 3:, 3:] = turn, tau[:, None, None] * np.eye(3)
    assert np.linalg.eigvalsh(information - less).min() > -1e-9


def test_a_wrong_minimum_is_never_certified():
    """A ring wound once too often is a minimum, and not the global one."""
    graph = circle(40, 0.03, 3)
    problem = problem_of(graph)
    wound = np.zeros((41, 3))
    wound[:40, 2] = np.arange(40) * 4 * np.pi / 40
    end = descend(problem.system, fit_of(problem.system, wound), 1e-9, 200)
    right = optimise(graph)
    assert end.converged
    assert end.fit.cost > 2 * right.cost
    assert not certify(problem.system, end.fit).trusted
    assert right.certificate is not None
    assert right.certificate.gap < 1e-2
    assert "Global optimality certified" in right.certainty


def test_where_the_cheapest_start_is_not_proven_others_are_followed():
    """A garage of three floors with few closures between them and bad odometry."""
    rng = np.random.default_rng(0)
    angle = np.arange(3 * 40) * 2 * np.pi / 40
    flat = np.column_stack([30 * np.cos(angle), 18 * np.sin(angle), angle + np.pi / 2])
    truth = planar_to_matrix(flat)
    truth[:, 2, 3] = 3 * angle / (2 * np.pi)
    tails = np.concatenate([np.arange(119), np.arange(0, 80, 20)])
    heads = np.concatenate([np.arange(1, 120), np.arange(0, 80, 20) + 40])
    sigma = np.array([0.2, 0.2, 0.2, 0.05, 0.05, 0.05])
    motion = np.linalg.inv(truth[tails]) @ truth[heads]
    measured = motion @ se3_exp(sigma * rng.normal(size=(len(tails), 6)))
    graph = PoseGraph(
        False,
        np.arange(120),
        np.tile(np.eye(4), (120, 1, 1)),
        Edges(
            tails,
            heads,
            measured,
            np.tile(np.diag(sigma**-2), (len(tails), 1, 1)),
            heads == tails + 1,
        ),
        landmarks=np.zeros((0, 3)),
        sightings=no_sightings(False),
        priors=no_priors(False),
    )
    alone, best = optimise(graph, ALONE), optimise(graph)
    assert best.cost <= alone.cost * (1 + 1e-6)
    assert best.cost == pytest.approx(min(best.reached.values()), rel=1e-5)
    if not (best.certificate and best.certificate.trusted):
        assert {"wraparound", "chordal"} <= set(best.reached)


@pytest.mark.parametrize("name", ["tinyGrid3D", "CSAIL", "intel"])
def test_recorded_graphs_are_certified(data, name):
    graph = read_graph(data / "graphs" / f"{name}.g2o").graph
    certificate = optimise(graph).certificate
    assert certificate is not None
    assert certificate.relaxation_is_global


def test_priors_and_fixed_nodes_leave_the_bound_below_the_cost():
    graph = ring(True)
    solved = optimise(replace(graph, fixed_ids=graph.ids[[0, 5]]))
    assert solved.certificate is not None
    assert solved.certificate.lower_bound <= solved.cost


def test_words_promise_no_more_than_is_proven() -> None:
    """However far below a bound lies, it is reported, and what was tried."""
    unproven = proof_of(Certificate(1.2, 0.94, True), ["chordal"])
    assert unproven.startswith("Global optimality not certified (gap 94 %).")
    assert unproven.endswith("Best of 1 start (chordal).")
    nothing = proof_of(Certificate(0.0, 1.0, False), ["chordal", "wraparound", "wraparound"])
    assert "(no bound known)" in nothing
    assert "Best of 3 starts (chordal, wraparound)." in nothing
    assert proof_of(Certificate(9.9, 0.01, False)).startswith(
        "Global optimality certified (gap 1 %)"
    )
