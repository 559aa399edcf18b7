"""Every start that a graph offers, before one of them is chosen."""

from __future__ import annotations

from contextlib import suppress

import numpy as np

from mapmyworld.backend.information import NotPositiveDefiniteError
from mapmyworld.backend.landmarks import first_places
from mapmyworld.backend.starts import chain_start, chordal_start
from mapmyworld.geometry import Array
from mapmyworld.graph.growth import grown_start
from mapmyworld.graph.problem import Problem


def starts_of(problem: Problem) -> dict[str, Array]:
    """Name -> poses (M, 3 or 4, 4) of nodes, the map's frame and landmarks."""
    if len(problem.graph.landmark_ids):
        return _starts_with_landmarks(problem, dead_reckoning(problem))
    return {**near_start(problem), **plain_starts(problem)}


def near_start(problem: Problem) -> dict[str, Array]:
    """The chordal start (N + 1, 3 or 4, 4), which leads to the global minimum most often.

    Nothing where it fails, or where there are landmarks.
    """
    graph, system, count = problem.graph, problem.system, problem.nodes
    if len(graph.landmark_ids):
        return {}
    guess = problem.guess[:count]
    ends = problem.anchors, system.tails, system.heads
    with suppress(NotPositiveDefiniteError):  # an edge that weighs nothing holds no node
        start = chordal_start(graph.planar, guess, *ends, system.measured, system.information)
        return {"chordal": start}
    return {}


def plain_starts(problem: Problem) -> dict[str, Array]:
    """Dead reckoning, and the stored poses, (N + 1, 3 or 4, 4) each: nodes and the map's frame."""
    return {"odometry": dead_reckoning(problem), "guess": problem.guess[: problem.nodes]}


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


def with_landmarks(problem: Problem, chain: Array) -> Array:
    """(M, 3 or 4, 4) dead reckoning, and every landmark where its first sighting puts it.

    `chain` (N + 1, 3 or 4, 4) is of nodes and the map's frame.
    """
    graph = problem.graph
    places = first_places(graph.planar, chain, graph.ids, graph.landmark_ids, graph.sightings)
    return np.concatenate([chain, places])


def _starts_with_landmarks(problem: Problem, chain: Array) -> dict[str, Array]:
    """Dead reckoning, the path grown from its beginning, and the guess where there is one."""
    graph, count = problem.graph, problem.nodes
    found = {
        "odometry": with_landmarks(problem, chain),
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
