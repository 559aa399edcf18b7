"""Closures that nothing predicts well, believed for what else they explain."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from test_graph_robust import PLAIN, SIGMA, drive

from mapmyworld.backend.connected_components import Index
from mapmyworld.backend.descent import optimised_roughly
from mapmyworld.backend.residuals import chi_squared_quantile
from mapmyworld.backend.system import System, believed_edges
from mapmyworld.graph.candidates import dead_reckoning
from mapmyworld.graph.group_hypothesis import explaining
from mapmyworld.graph.inlier_recovery import recoverable
from mapmyworld.graph.optimisation import optimise_robustly
from mapmyworld.graph.problem import problem_of
from mapmyworld.types.pose_graph import PoseGraph

ROUND = 500  # nodes
LIMIT = float(chi_squared_quantile(0.9999, 3))


@dataclass(frozen=True)
class Question:
    system: System
    poses: np.ndarray
    trusted: np.ndarray
    closures: Index
    groups: Index


def two_rounds(pairs: np.ndarray, seed: int = 4) -> PoseGraph:
    """A round of 500 m driven twice, a metre a step: the second is badly known by odometry."""
    angle = 2 * np.pi * np.arange(2 * ROUND) / ROUND
    radius = ROUND / (2 * np.pi)
    truth = np.column_stack([radius * np.cos(angle), radius * np.sin(angle), angle + np.pi / 2])
    return drive(truth, pairs, seed)


def with_strangers(graph: PoseGraph, count: int) -> PoseGraph:
    """The graph with false closures of random nodes, places and headings."""
    rng, edges = np.random.default_rng(7), graph.edges
    tails = rng.integers(0, ROUND, count)
    places = rng.uniform(-20, 20, (count, 2))
    motions = np.column_stack([places, rng.uniform(-np.pi, np.pi, count)])
    return graph.__class__(
        True,
        graph.ids,
        graph.map_from_node,
        edges.__class__(
            np.concatenate([edges.from_ids, tails]),
            np.concatenate([edges.to_ids, tails + ROUND]),
            np.concatenate([edges.i_from_j, motions]),
            np.concatenate([edges.information, np.tile(np.diag(SIGMA**-2.0), (count, 1, 1))]),
            np.concatenate([edges.odometry, np.zeros(count, np.bool_)]),
        ),
        landmarks=graph.landmarks,
        sightings=graph.sightings,
        priors=graph.priors,
    )


def question_of(graph: PoseGraph, groups: np.ndarray) -> Question:
    """All closures left out; `groups` numbers those of the graph in its order."""
    problem = problem_of(graph)
    system, trusted = problem.system, graph.edges.odometry[problem.order]
    poses = optimised_roughly(believed_edges(system, trusted), dead_reckoning(problem))
    number = np.full(len(graph.edges), -1)
    number[~graph.edges.odometry] = groups
    closures = np.flatnonzero(~trusted)
    return Question(system, poses, trusted, closures, number[problem.order][closures])


def explained(question: Question) -> np.ndarray:
    """Groups of the closures that come in."""
    found = explaining(
        question.system,
        question.poses,
        question.trusted,
        question.closures,
        question.groups,
        LIMIT,
        1.0,
    )
    return question.groups[found[question.closures]]


SECTIONS = [(k, k + ROUND) for start in (50, 70, 90, 110) for k in range(start, start + 8)]


def test_a_group_is_believed_when_it_makes_others_fit_as_never_by_chance() -> None:
    graph = with_strangers(two_rounds(np.array(SECTIONS)), 300)
    groups = np.concatenate([np.repeat([0, 1, 2, 3], 8), np.arange(4, 304)])
    question = question_of(graph, groups)
    plain = recoverable(question.system, question.poses, question.trusted, LIMIT, 1.0)
    assert not plain.any()  # each alone may fit by chance: the prediction is metres wide
    assert np.array_equal(np.bincount(explained(question), minlength=4), [8, 8, 8, 8])


def test_a_group_alone_explains_nothing() -> None:
    """It agrees with itself and fits what odometry allows, as a false one of a corridor may."""
    graph = with_strangers(two_rounds(np.array(SECTIONS[:8])), 300)
    question = question_of(graph, np.concatenate([np.zeros(8, int), np.arange(4, 304)]))
    assert len(explained(question)) == 0


def test_a_second_round_is_joined_to_the_first_among_many_false_closures() -> None:
    graph = with_strangers(two_rounds(np.array(SECTIONS)), 300)
    solved = optimise_robustly(graph, PLAIN)
    true = np.arange(len(graph.edges)) < len(graph.edges) - 300
    assert np.array_equal(solved.accepted, true)
