"""A pose graph as a least-squares system, in an order that does not depend on the file's."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from mapmyworld.errors import GraphError
from mapmyworld.geometry import Array
from mapmyworld.graph.landmarks import as_edges
from mapmyworld.graph.pose_graph import Index, canonical_order, components, held_nodes, positions
from mapmyworld.graph.system import System, number_free
from mapmyworld.types.pose_graph import PoseGraph


@dataclass(frozen=True, slots=True, eq=False)
class Problem:
    """A graph as a system: nodes, then the map's own frame, then landmarks."""

    graph: PoseGraph
    system: System
    """Edges in canonical order, then priors, then sightings."""
    guess: Array
    """Poses of all, landmarks at zero."""
    anchors: Index
    """The map's frame, fixed nodes, and the first node of every part that has neither."""
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
    held = np.append(positions(graph.ids, graph.fixed_ids), count)
    stays = held_nodes(total, tails, heads, held)
    stays[count + 1 :] = False
    anchors = np.flatnonzero(stays)
    stays[count + 1 :] = np.bincount(heads, minlength=total)[count + 1 :] == 0  # never seen
    system = System(
        graph.planar,
        tails,
        heads,
        np.concatenate([edges.from_from_to, prior_poses, measured]),
        np.concatenate([edges.information, prior_information, information]),
        number_free(stays),
        np.concatenate([np.zeros(len(edges) + len(priors), np.int64), kinds])
        if len(kinds)
        else None,
    )
    extra = np.broadcast_to(world, (total - count, *world.shape))
    guess = np.concatenate([graph.map_from_node, extra])
    return Problem(graph, system, guess, anchors, order, component)
