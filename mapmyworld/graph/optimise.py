"""The pose graph, optimised: the best of several starts, by Levenberg-Marquardt."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from mapmyworld.config.graph import GraphConfig
from mapmyworld.errors import GraphError
from mapmyworld.geometry import Array
from mapmyworld.graph.levenberg import minimise
from mapmyworld.graph.pose_graph import Index, canonical_order, components, positions
from mapmyworld.graph.residuals import edge_residuals, squared_sigmas
from mapmyworld.graph.starts import chain_start, chordal_start
from mapmyworld.types.pose_graph import Edges, PoseGraph


@dataclass(frozen=True, slots=True, eq=False)
class OptimisedGraph:
    """Where the nodes of a graph are, and how good that is."""

    graph: PoseGraph
    """The graph with the solved poses and landmarks in place of the guesses."""
    cost: float
    """Half the sum of squared sigmas."""
    start: str
    """The start that led there: "chordal", "odometry" or "guess"."""
    start_costs: dict[str, float]
    """The cost of every start before optimisation."""
    iterations: int
    converged: bool
    squared_sigmas: NDArray[np.float64]
    """(E,) chi-squared of every edge, in the graph's order."""
    component: NDArray[np.int64]
    """(N,) connected part of every node, numbered by first node."""


def optimise(graph: PoseGraph, config: GraphConfig | None = None) -> OptimisedGraph:
    """The graph with every node where all edges together want it.

    The result does not depend on the order of nodes and edges, nor on a rigid motion of the
    world; the first node of every connected part stays at its guess.
    """
    config = config or GraphConfig()
    if len(graph) == 0:
        raise GraphError("the graph has no nodes: nothing to optimise")
    order = canonical_order(graph.edges)
    edges = graph.edges.chosen(order)
    tails, heads = positions(graph.ids, edges.from_ids), positions(graph.ids, edges.to_ids)
    if (tails < 0).any() or (heads < 0).any():
        raise GraphError("the graph has edges between nodes that it does not have")
    component = components(len(graph), tails, heads)
    anchors = np.unique(component, return_index=True)[1].astype(np.int64)
    starts = _starts(graph, edges, tails, heads, anchors)
    costs = {
        name: 0.5 * float(_chi2(graph.planar, edges, tails, heads, poses).sum())
        for name, poses in starts.items()
    }
    best = min(costs, key=lambda name: costs[name])
    solution = minimise(graph.planar, starts[best], tails, heads, edges, anchors, config)
    chi2 = np.empty(len(edges))
    chi2[order] = _chi2(graph.planar, edges, tails, heads, solution.poses)
    return OptimisedGraph(
        replace(graph, map_from_node=solution.poses),
        0.5 * float(chi2[order].sum()),
        best,
        costs,
        solution.iterations,
        solution.converged,
        chi2,
        component,
    )


def _starts(
    graph: PoseGraph, edges: Edges, tails: Index, heads: Index, anchors: Index
) -> dict[str, Array]:
    guess, measured = graph.map_from_node, edges.from_from_to
    return {
        "odometry": chain_start(graph.planar, guess, tails, heads, measured, edges.odometry),
        "chordal": chordal_start(
            graph.planar, guess, anchors, tails, heads, measured, edges.information
        ),
        "guess": guess,
    }


def _chi2(planar: bool, edges: Edges, tails: Index, heads: Index, poses: Array) -> Array:
    residuals = edge_residuals(planar, poses[tails], poses[heads], edges.from_from_to)
    return squared_sigmas(residuals, edges.information)
