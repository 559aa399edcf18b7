"""A pose graph, optimised: the best of several starts, by Levenberg-Marquardt."""

from __future__ import annotations

from contextlib import suppress
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from mapmyworld.config.graph import GraphConfig
from mapmyworld.errors import GraphError
from mapmyworld.geometry import Array
from mapmyworld.graph.cholesky import NotPositiveDefiniteError
from mapmyworld.graph.growth import grown_start
from mapmyworld.graph.landmarks import as_edges, first_places
from mapmyworld.graph.pose_graph import Index, canonical_order, components, positions
from mapmyworld.graph.robust import descend, solve_robustly
from mapmyworld.graph.starts import chain_start, chordal_start
from mapmyworld.graph.system import System, chosen_edges, edge_chi2, number_free
from mapmyworld.types.pose_graph import PoseGraph

# Planar nodes from which gtsam's default ordering fills in more than minimum degree does.
_OURS = 12_000


@dataclass(frozen=True, slots=True, eq=False)
class OptimisedGraph:
    """Where the nodes of a graph are, and how good that is."""

    graph: PoseGraph
    """The graph with the solved poses and landmarks in place of the guesses."""
    cost: float
    """Half the sum of squared sigmas of what was accepted."""
    start: str
    """The start that led there: "chordal", "odometry" or "guess"."""
    start_costs: dict[str, float]
    """The cost of every start before optimisation."""
    iterations: int
    converged: bool
    squared_sigmas: NDArray[np.float64]
    """(E,) chi-squared of every edge, in the graph's order."""
    accepted: NDArray[np.bool_]
    """(E,) edges that count; all of them unless solved robustly."""
    component: NDArray[np.int64]
    """(N,) connected part of every node, numbered by first node."""
    certainty: str
    """What is known about the minimum."""


@dataclass(frozen=True, slots=True, eq=False)
class Problem:
    """A graph as a system: nodes, then the map's own frame, then landmarks."""

    graph: PoseGraph
    system: System
    """Edges in canonical order, then priors, then sightings."""
    guess: Array
    """Poses of all, landmarks at zero."""
    anchors: Index
    order: Index
    """(E,) the graph's edges in canonical order."""
    component: Index
    """(N,) of the graph's nodes."""

    @property
    def nodes(self) -> int:
        """Nodes and the map's own frame."""
        return len(self.graph) + 1


def optimise(graph: PoseGraph, config: GraphConfig | None = None) -> OptimisedGraph:
    """The graph with every node where all edges together want it.

    The result does not depend on the order of nodes and edges, nor on a rigid motion of the
    world; the first node of every connected part stays at its guess unless priors place it.
    """
    config = config or GraphConfig()
    problem = problem_of(graph)
    starts = _starts(problem)
    costs = {name: _cost(problem.system, poses) for name, poses in starts.items()}
    best = min(costs, key=lambda name: costs[name])
    poses, iterations, converged = _minimise(problem, starts[best], config)
    every = np.ones(len(problem.system.tails), np.bool_)
    return _result(problem, poses, every, best, costs, iterations, converged)


def optimise_robustly(graph: PoseGraph, config: GraphConfig | None = None) -> OptimisedGraph:
    """The graph solved without the edges that contradict odometry and each other."""
    config = config or GraphConfig()
    problem = problem_of(graph)
    if len(graph.sightings):
        raise GraphError("graphs with landmarks cannot be solved robustly yet: leave out --robust")
    system = problem.system
    trusted = np.ones(len(system.tails), np.bool_)
    trusted[: len(graph.edges)] = graph.edges.odometry[problem.order]
    start = _starts(problem)["odometry"]
    solution = solve_robustly(system, start, problem.anchors, trusted, config)
    part = chosen_edges(system, solution.inliers)
    poses, iterations, converged = descend(
        part, solution.poses, config.tolerance, config.iterations
    )
    costs = {"odometry": _cost(system, start)}
    return _result(problem, poses, solution.inliers, "odometry", costs, iterations, converged)


def problem_of(graph: PoseGraph) -> Problem:
    """The system of a graph; raises `GraphError` when edges name nodes that it lacks."""
    if len(graph) == 0:
        raise GraphError("the graph has no nodes: nothing to optimise")
    order = canonical_order(graph.edges)
    edges, seen, count = graph.edges.chosen(order), graph.sightings, len(graph)
    measured, information, kinds = as_edges(graph.planar, seen)
    landmarks = positions(graph.landmark_ids, seen.landmark_ids)
    at = [positions(graph.ids, ids) for ids in (edges.from_ids, edges.to_ids, seen.node_ids)]
    priors = positions(graph.ids, graph.priors.ids)
    prior_poses = graph.priors.map_from_node.reshape(-1, *graph.map_from_node.shape[1:])
    prior_information = graph.priors.information.reshape(-1, *edges.information.shape[1:])
    if any((k < 0).any() for k in (*at, landmarks, priors)):
        raise GraphError("the graph has edges, sightings or priors of nodes that it does not have")
    tails = np.concatenate([at[0], np.full(len(priors), count), at[2]])
    heads = np.concatenate([at[1], priors, landmarks + count + 1])
    world = np.zeros(3) if graph.planar else np.eye(4)
    total = count + 1 + len(graph.landmark_ids)
    component = components(count, at[0], at[1])
    anchors = _anchors(total, count, tails, heads, positions(graph.ids, graph.fixed_ids))
    free = number_free(total, anchors)
    unseen = np.setdiff1d(np.arange(count + 1, total), heads)
    system = System(
        graph.planar,
        tails,
        heads,
        np.concatenate([edges.from_from_to, prior_poses, measured]),
        np.concatenate([edges.information, prior_information, information]),
        number_free(total, np.concatenate([anchors, unseen])) if len(unseen) else free,
        np.concatenate([np.zeros(len(edges) + len(priors), np.int64), kinds])
        if len(kinds)
        else None,
    )
    extra = np.broadcast_to(world, (total - count, *world.shape))
    guess = np.concatenate([graph.map_from_node, extra])
    return Problem(graph, system, guess, anchors, order, component)


def _anchors(total: int, world: int, tails: Index, heads: Index, fixed: Index) -> Index:
    """The map's frame, fixed nodes, and the first node of every part that has neither."""
    held = np.concatenate([[world], fixed]).astype(np.int64)
    part = components(total, tails, heads)
    first = np.unique(part, return_index=True)[1]
    loose = first[~np.isin(part[first], part[held])]
    return np.unique(np.concatenate([held, loose[loose < world]])).astype(np.int64)


def _starts(problem: Problem) -> dict[str, Array]:
    graph, system, count = problem.graph, problem.system, problem.nodes
    poses = len(graph.edges) + len(graph.priors)
    tails, heads = system.tails[:poses], system.heads[:poses]
    measured, information = system.measured[:poses], system.information[:poses]
    trusted = np.zeros(poses, np.bool_)
    trusted[: len(graph.edges)] = graph.edges.odometry[problem.order]
    guess, anchors = problem.guess[:count], problem.anchors
    chain = chain_start(graph.planar, guess, tails, heads, measured, trusted)
    chain[anchors] = guess[anchors]
    if len(graph.landmark_ids):
        return _starts_with_landmarks(problem, chain)
    found = {"odometry": chain}
    with suppress(NotPositiveDefiniteError):  # an edge that weighs nothing holds no node
        found["chordal"] = chordal_start(
            graph.planar, guess, anchors, tails, heads, measured, information
        )
    found["guess"] = guess
    return found


def _starts_with_landmarks(problem: Problem, chain: Array) -> dict[str, Array]:
    """Dead reckoning, the path grown from its beginning, and the guess where there is one."""
    graph, count = problem.graph, problem.nodes
    places = first_places(graph.planar, chain, graph.ids, graph.landmark_ids, graph.sightings)
    found = {
        "odometry": np.concatenate([chain, places]),
        "growing": grown_start(graph, problem.system, chain),
    }
    if np.ptp(graph.landmarks, axis=0).any():
        guess = problem.guess.copy()
        if graph.planar:
            guess[count:, :2] = graph.landmarks
        else:
            guess[count:, :3, 3] = graph.landmarks
        found["guess"] = guess
    return found


def _cost(system: System, poses: Array) -> float:
    return 0.5 * float(edge_chi2(system, poses).sum())


def _minimise(problem: Problem, start: Array, config: GraphConfig) -> tuple[Array, int, bool]:
    """By gtsam; by our own descent where it cannot (landmarks, priors) or is the slower one."""
    graph, system = problem.graph, problem.system
    plain = not (len(graph.priors) or len(graph.sightings) or len(graph.fixed_ids))
    if system.size == 0:
        return start, 0, True
    if not plain or (graph.planar and len(graph) > _OURS):
        return descend(system, start, config.tolerance, config.iterations)
    from mapmyworld.graph.levenberg import minimise

    count = len(graph)
    edges = graph.edges.chosen(problem.order)
    anchors = problem.anchors[problem.anchors < count]
    found = minimise(start[:count], system.tails, system.heads, edges, anchors, config)
    return np.concatenate([found.poses, start[count:]]), found.iterations, found.converged


def _result(
    problem: Problem,
    poses: Array,
    accepted: NDArray[np.bool_],
    start: str,
    costs: dict[str, float],
    iterations: int,
    converged: bool,
) -> OptimisedGraph:
    graph, count = problem.graph, problem.nodes
    squares = edge_chi2(problem.system, poses)
    cost = 0.5 * float(squares[accepted].sum())
    chi2, good = np.empty(len(graph.edges)), np.empty(len(graph.edges), np.bool_)
    chi2[problem.order] = squares[: len(graph.edges)]
    good[problem.order] = accepted[: len(graph.edges)]
    places = poses[count:, :2] if graph.planar else poses[count:, :3, 3]
    solved = replace(graph, map_from_node=poses[: count - 1], landmarks=places)
    from mapmyworld.graph.certificate import certainty_of

    statement = certainty_of(chosen_edges(problem.system, accepted), poses, converged)
    return OptimisedGraph(
        solved,
        cost,
        start,
        costs,
        iterations,
        converged,
        chi2,
        good,
        problem.component,
        statement,
    )
