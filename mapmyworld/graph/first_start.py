"""Where the optimisation of a graph begins."""

from __future__ import annotations

import numpy as np

from mapmyworld.backend.information import NotPositiveDefiniteError
from mapmyworld.backend.starts import chain_start, chordal_start
from mapmyworld.geometry import Array
from mapmyworld.graph.growth import grown_start
from mapmyworld.graph.problem import Problem


def first_start(problem: Problem) -> tuple[str, Array]:
    """Name and poses (M, 3 or 4, 4) of nodes, the map's frame and landmarks.

    The chordal start leads to the global minimum most often. Where there are landmarks the path
    grows from its beginning, and where an edge weighs nothing, dead reckoning has to do.
    """
    graph, system, count = problem.graph, problem.system, problem.nodes
    if len(graph.landmark_ids):
        return "growing", grown_start(graph, system, dead_reckoning(problem))
    guess = problem.guess[:count]
    ends = problem.anchors, system.tails, system.heads
    try:
        start = chordal_start(graph.planar, guess, *ends, system.measured, system.information)
    except NotPositiveDefiniteError:  # an edge that weighs nothing holds no node
        return "odometry", dead_reckoning(problem)
    return "chordal", start


def dead_reckoning(problem: Problem) -> Array:
    """Poses (N + 1, 3 or 4, 4) of nodes and the map's frame, by odometry first."""
    graph, system = problem.graph, problem.system
    poses = len(graph.edges) + len(graph.priors)
    trusted = np.zeros(poses, np.bool_)
    trusted[: len(graph.edges)] = graph.edges.odometry[problem.order]
    guess, anchors = problem.guess[: problem.nodes], problem.anchors
    tails, heads = system.tails[:poses], system.heads[:poses]
    chain = chain_start(graph.planar, guess, tails, heads, system.measured[:poses], trusted)
    chain[anchors] = guess[anchors]
    return chain
