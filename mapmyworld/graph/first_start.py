"""Where the optimisation of a graph begins; with landmarks the path grows from its beginning.

Dead reckoning drifts too far for the first sighting of a landmark to be near its place; solving
as one goes keeps every new sighting near.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from mapmyworld.backend.descent import optimised_roughly
from mapmyworld.backend.information import NotPositiveDefiniteError
from mapmyworld.backend.landmarks import first_places
from mapmyworld.backend.starts import along_tree, chordal_start, spanning_tree
from mapmyworld.backend.system import System, chosen_edges, number_free
from mapmyworld.geometry import Array
from mapmyworld.geometry.planar import between_planar, compose_planar
from mapmyworld.geometry.rigid import between
from mapmyworld.graph.problem import Problem
from mapmyworld.types.pose_graph import PoseGraph

_PARTS = 25  # at most, of equal length
_SHORTEST = 100  # nodes of a part at least
_ROUGH = 0.1  # of the cost: a step that gains less ends a part, as the next one needs no more


def grown_start(graph: PoseGraph, system: System, chain: Array) -> Array:
    """Poses (M, 3 or 4, 4) of nodes, the map's frame and landmarks.

    `chain` (N + 1, 3 or 4, 4) is dead reckoning.
    """
    count = len(graph)
    step = max(_SHORTEST, -(-count // _PARTS))
    nodes = chain.copy()
    places = np.zeros((len(graph.landmark_ids), *chain.shape[1:]))
    seen = np.zeros((len(places), *[1] * (chain.ndim - 1)), np.bool_)
    last = 0
    while last < count:
        first, last = last, min(count, last + step)
        if first:
            nodes[first:last] = _continued(graph.planar, nodes[first - 1], chain, first, last)
        fresh = first_places(graph.planar, nodes, graph.ids, graph.landmark_ids, graph.sightings)
        places = np.where(seen, places, fresh)
        poses = np.concatenate([nodes, places])
        known = np.zeros(len(poses), np.bool_)
        known[:last] = known[count] = True
        inside = known[system.tails]
        known[system.heads[inside & (system.heads > count)]] = True
        seen = known[count + 1 :].reshape(seen.shape)
        used = inside & known[system.heads]
        free = number_free(~known | (system.free < 0))
        part = replace(chosen_edges(system, used), free=free)
        poses = optimised_roughly(part, poses, _ROUGH)
        nodes, places = poses[: count + 1], poses[count + 1 :]
    return np.concatenate([nodes, places])


def _continued(planar: bool, before: Array, chain: Array, first: int, last: int) -> Array:
    """Dead reckoning from `first` on, joined to the solved pose before it."""
    if planar:
        return compose_planar(before, between_planar(chain[first - 1], chain[first:last]))
    return np.asarray(before @ between(chain[first - 1], chain[first:last]))


def first_start(problem: Problem) -> tuple[str, Array]:
    """Name and poses (M, 3 or 4, 4) of nodes, the map's frame and landmarks.

    The chordal start leads to the global minimum most often. Where there are landmarks the path
    grows from its beginning, and where an edge weighs nothing, dead reckoning has to do.
    """
    graph, system = problem.graph, problem.system
    if len(graph.landmark_ids):
        return "growing", grown_start(graph, system, dead_reckoning(problem))
    try:
        start = chordal_start(system, problem.guess[: problem.nodes], problem.anchors)
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
    penalty = np.where(trusted, 0, len(guess))  # short jumps of odometry come first
    tree = spanning_tree(chosen_edges(system, np.arange(poses)), len(guess), penalty)
    chain = along_tree(graph.planar, guess, tree.parents, tree.motions)
    chain[anchors] = guess[anchors]
    return chain
