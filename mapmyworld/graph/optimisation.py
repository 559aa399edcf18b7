"""A pose graph, optimised until its minimum is proven, and what is proven of the result."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import suppress
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from mapmyworld.backend.certificate import Certificate, certainty_of, certify
from mapmyworld.backend.descent import Descent, descend
from mapmyworld.backend.information import NotPositiveDefiniteError
from mapmyworld.backend.system import Fit, System, chosen_edges, fit_of
from mapmyworld.backend.wraparound import wraparound_starts
from mapmyworld.config import GraphConfig
from mapmyworld.geometry import Array
from mapmyworld.graph.first_start import dead_reckoning, first_start, grown_start
from mapmyworld.graph.problem import Problem, problem_of
from mapmyworld.graph.robust import solve_robustly
from mapmyworld.parallel import on_one_thread
from mapmyworld.types.pose_graph import PoseGraph

_LARGEST = 10_000  # nodes up to which starts with other wraparounds are worth their minutes
_WRAPAROUNDS = 12  # starts with other wraparounds that are followed from one minimum
_TOGETHER = 6000  # nodes of all of them together, of large graphs
_ROUNDS = 4  # minima from which they are


@dataclass(frozen=True, slots=True, eq=False)
class OptimisedGraph:
    """Where the nodes of a graph are, and how good that is."""

    graph: PoseGraph
    """The graph with the solved poses and landmarks in place of the guesses."""
    cost: float
    """Half the sum of squared sigmas of what was accepted."""
    start: str
    """The start that led there: "chordal", "odometry", "growing", "wraparound"."""
    start_costs: dict[str, float]
    """The cost of the first start, before optimisation."""
    reached: dict[str, float]
    """The cost that each start which was followed led to."""
    iterations: int
    converged: bool
    squared_sigmas: NDArray[np.float64]
    """(E,) chi-squared of every edge, in the graph's order."""
    accepted: NDArray[np.bool_]
    """(E,) edges that count; all of them unless solved robustly."""
    component: NDArray[np.int64]
    """(N,) connected component of every node, numbered by first node."""
    certificate: Certificate | None
    """What is proven; None when it was not asked for."""
    certainty: str
    """What is known about the minimum, in words."""


@on_one_thread
def optimise(graph: PoseGraph, config: GraphConfig | None = None) -> OptimisedGraph:
    """The graph with every node where all edges together want it.

    Where the minimum below the first start is not proven to be the global one, those with other
    wraparounds are looked at as well. The result does not depend on the order of nodes and edges,
    nor on a rigid motion of the world; the first node of every connected component stays at its
    guess unless priors place it.
    """
    config = config or GraphConfig()
    problem = problem_of(graph)
    name, poses = first_start(problem)
    start = fit_of(problem.system, poses)
    best, certificate = _descended(problem.system, name, start, config), None
    followed = [best]
    if config.certify:
        best, certificate, followed = _best_of_all(problem, best, config)
    every = np.ones(len(problem.system.tails), np.bool_)
    return _result(problem, every, {name: start.cost}, best, certificate, followed)


def _descended(system: System, name: str, start: Fit, config: GraphConfig) -> Descent:
    return replace(descend(system, start, config.tolerance, config.iterations), start=name)


def _best_of_all(
    problem: Problem, best: Descent, config: GraphConfig
) -> tuple[Descent, Certificate, list[Descent]]:
    """The cheapest minimum, looked for until one is proven to be the global one."""
    system, followed = problem.system, [best]
    certificate = certify(system, best.fit)
    if certificate.trusted:
        return best, certificate, followed
    for start in _other_starts(problem, followed):
        followed.append(_descended(system, "wraparound", fit_of(system, start), config))
        if followed[-1].fit.cost < (1.0 - config.tolerance) * best.fit.cost:
            best = followed[-1]
            certificate = certify(system, best.fit)
            if certificate.trusted:
                break
    return best, certificate, followed


def _other_starts(problem: Problem, followed: list[Descent]) -> Iterator[Array]:
    """Poses (N, 3 or 4, 4), made when they are asked for; `followed` grows meanwhile."""
    count = len(problem.graph)
    if len(problem.graph.sightings) or count > _LARGEST:
        return  # no other start comes near that of a growing path
    for _ in range(_ROUNDS):
        before = _cheapest(followed)
        most = min(_WRAPAROUNDS, 1 + _TOGETHER // count)
        with suppress(NotPositiveDefiniteError):  # an edge that weighs nothing holds no node
            yield from wraparound_starts(problem.system, before.fit.poses, most)
        if _cheapest(followed) is before:
            break


def _cheapest(followed: list[Descent]) -> Descent:
    return min(followed, key=lambda one: one.fit.cost)


@on_one_thread
def optimise_robustly(graph: PoseGraph, config: GraphConfig | None = None) -> OptimisedGraph:
    """The graph solved without the edges that contradict odometry and each other."""
    config = config or GraphConfig()
    problem = problem_of(graph)
    system = problem.system
    trusted = np.ones(len(system.tails), np.bool_)
    trusted[: len(graph.edges)] = graph.edges.odometry[problem.order]
    start = dead_reckoning(problem)
    if len(graph.landmark_ids):
        start = grown_start(graph, chosen_edges(system, trusted), start)
    solution = solve_robustly(system, start, problem.anchors, trusted, config)
    part = chosen_edges(system, solution.inliers)
    end = _descended(part, "odometry", fit_of(part, solution.poses), config)
    certificate = certify(part, end.fit) if config.certify else None
    costs = {"odometry": fit_of(system, start).cost}
    found = replace(end, fit=fit_of(system, end.fit.poses))
    return _result(problem, solution.inliers, costs, found, certificate, [found])


def _reached(followed: list[Descent]) -> dict[str, float]:
    """The cheapest cost by start, in the order in which they were followed."""
    found: dict[str, float] = {}
    for one in followed:
        found[one.start] = min(one.fit.cost, found.get(one.start, np.inf))
    return found


def _result(
    problem: Problem,
    accepted: NDArray[np.bool_],
    costs: dict[str, float],
    best: Descent,
    certificate: Certificate | None,
    followed: list[Descent],
) -> OptimisedGraph:
    graph, count = problem.graph, problem.nodes
    poses, squares = best.fit.poses, best.fit.squares
    chi2, good = np.empty(len(graph.edges)), np.empty(len(graph.edges), np.bool_)
    chi2[problem.order] = squares[: len(graph.edges)]
    good[problem.order] = accepted[: len(graph.edges)]
    places = poses[count:, :2] if graph.planar else poses[count:, :3, 3]
    freedom = problem.system.dimension * int(accepted.sum()) - problem.system.size
    cost = 0.5 * float(squares[accepted].sum())
    return OptimisedGraph(
        replace(graph, map_from_node=poses[: count - 1], landmarks=places),
        cost,
        best.start,
        costs,
        _reached(followed),
        best.iterations,
        best.converged,
        chi2,
        good,
        problem.component,
        certificate,
        certainty_of(freedom, cost, best.converged, certificate, [one.start for one in followed]),
    )
