"""A pose graph as a least-squares system, in an order that does not depend on the file's."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import accumulate

import numpy as np

from mapmyworld.backend.connected_components import components, held_nodes, positions
from mapmyworld.backend.landmarks import as_edges
from mapmyworld.backend.system import System, number_free
from mapmyworld.errors import GraphError
from mapmyworld.geometry import Array, Index
from mapmyworld.graph.canonical_graph import canonical_order
from mapmyworld.types.pose_graph import Edges, PoseGraph


@dataclass(frozen=True, slots=True, eq=False)
class Problem:
    """A graph as a system: nodes, then the map's own frame, then landmarks."""

    graph: PoseGraph
    system: System
    """Edges in canonical order, then priors, then sightings."""
    guess: Array
    """(M, 3 or 4, 4) poses of all, map_from_node, landmarks at zero."""
    anchors: Index
    """(A,) the map's frame, fixed nodes, and the first node of every component that has neither."""
    order: Index
    """(E,) the graph's edges in canonical order."""
    component: Index
    """(N,) of the graph's nodes."""

    @property
    def nodes(self) -> int:
        """Nodes and the map's own frame."""
        return len(self.graph) + 1


def problem_of(graph: PoseGraph) -> Problem:
    """The system of a graph; raises `GraphError` when edges name nodes that it lacks."""
    if len(graph) == 0:
        raise GraphError("the graph has no nodes: nothing to optimise")
    order = canonical_order(graph.edges)
    edges, count = graph.edges.chosen(order), len(graph)
    measured, information, kinds = as_edges(graph.planar, graph.sightings)
    tails, heads = _ends(graph, edges)
    total = count + 1 + len(graph.landmark_ids)
    component = components(count, tails[: len(edges)], heads[: len(edges)])
    held = np.concatenate([positions(graph.ids, graph.fixed_ids), [count]])
    stays = held_nodes(total, tails, heads, held)
    stays[count + 1 :] = False
    anchors = np.flatnonzero(stays)
    stays[count + 1 :] = np.bincount(heads, minlength=total)[count + 1 :] == 0  # never seen
    priors = graph.priors
    poses = priors.map_from_node.reshape(-1, *graph.map_from_node.shape[1:])
    weights = priors.information.reshape(-1, *edges.information.shape[1:])
    system = System(
        graph.planar,
        tails,
        heads,
        np.concatenate([edges.i_from_j, poses, measured]),
        np.concatenate([edges.information, weights, information]),
        number_free(stays),
        np.concatenate([np.zeros(len(tails) - len(kinds), np.int64), kinds])
        if len(kinds)
        else None,
    )
    guess = np.zeros((total, *graph.map_from_node.shape[1:]))
    guess[:count], guess[count:] = graph.map_from_node, 0.0 if graph.planar else np.eye(4)
    return Problem(graph, system, guess, anchors, order, component)


def _ends(graph: PoseGraph, edges: Edges) -> tuple[Index, Index]:
    """Tails and heads of edges, priors and sightings as positions of nodes."""
    seen, count = graph.sightings, len(graph)
    named = edges.from_ids, edges.to_ids, graph.priors.ids, seen.node_ids
    a, b, c, _ = accumulate(map(len, named))
    at = positions(graph.ids, np.concatenate(named))
    landmarks = positions(graph.landmark_ids, seen.landmark_ids)
    if at.min(initial=0) < 0 or landmarks.min(initial=0) < 0:
        raise GraphError("edges, observations or priors name nodes that the graph lacks: add them")
    tails = np.concatenate([at[:a], np.full(c - b, count), at[c:]])
    return tails, np.concatenate([at[a:c], landmarks + (count + 1)])
