"""Nodes and constraints in, solved poses and judged constraints out: what `build` calls."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from mapmyworld.backend.certificate import certify, proof_of
from mapmyworld.backend.connected_components import components
from mapmyworld.backend.descent import optimised_roughly
from mapmyworld.backend.system import believed_edges, edge_chi2, fit_of
from mapmyworld.config import GraphConfig
from mapmyworld.decisions import decided
from mapmyworld.geometry import Array, Index
from mapmyworld.geometry.planar import planar_to_matrix
from mapmyworld.graph.constraint_system import StatedSystem, stated_system
from mapmyworld.graph.covariance import marginal_covariances, spatial_covariances
from mapmyworld.graph.graph_verdicts import faults_of, judged
from mapmyworld.graph.robust import RobustSolution, solve_robustly
from mapmyworld.parallel import on_one_thread
from mapmyworld.types import Judge, Judged, Poses


@dataclass(frozen=True, slots=True, eq=False)
class SolvedGraph:
    """Where the nodes are, what became of every constraint, and how confident that is."""

    poses: Poses
    constraints: tuple[Judged, ...]
    """All that were given, in their order, with the graph's verdict where it was asked."""
    component: NDArray[np.int64]
    """(N,) connected component of every node of `poses`, numbered by first node."""
    cost: float
    """Half the sum of squared sigmas of the accepted constraints."""
    certainty: str
    """What is known about the solution: connection, consistency, global minimum."""


@on_one_thread
def solve(
    ids: Sequence[int] | Index,
    initial: Array,
    constraints: Sequence[Judged],
    planar: bool,
    config: GraphConfig | None = None,
) -> SolvedGraph:
    """The graph of nodes `ids` (N,) at `initial` poses (N, 4, 4), solved robustly and judged.

    Constraints that come rejected stay so, unless an earlier `solve` rejected them: its verdicts
    are forgotten first. Motion, priors and what a person stated are believed;
    closures must agree with these and with each other. The first node of every connected component
    stays at its initial pose, unless a prior ties the component to the map's frame.
    """
    config = config or GraphConfig()
    constraints = [c.before(Judge.GRAPH) for c in constraints]
    known = np.asarray(ids, np.int64)
    order = np.lexsort((np.abs(known), known < 0))  # nodes, then landmarks
    known = known[order]
    guess = np.asarray(initial, np.float64).reshape(-1, 4, 4)[order]
    nodes = set(known.tolist())
    faults = faults_of(constraints, nodes)
    used = np.flatnonzero([c.accepted and not f for c, f in zip(constraints, faults, strict=True)])
    stated = stated_system(known, guess, [constraints[k] for k in used.tolist()], planar)
    system, solution = stated.system, _solved(stated, config)
    poses = solution.poses[: len(known)]
    matrices = planar_to_matrix(poses) if planar else poses
    verdicts = judged(constraints, faults, used, solution, system)
    linked = solution.inliers & (system.tails < len(known))
    part = components(len(known), system.tails[linked], system.heads[linked])
    cost = 0.5 * float(solution.chi2[solution.inliers].sum())
    agreeing = int(solution.consistency.clique.sum())
    statement = f"{agreeing} closures agree with a neighbouring closure."
    believed = believed_edges(system, solution.inliers)
    if config.certify and config.covariances:  # a draft needs neither
        statement += f" {proof_of(certify(believed, fit_of(believed, solution.poses)))}"
    found = marginal_covariances(believed, solution.poses) if config.covariances else None
    spread = None if found is None else spatial_covariances(planar, found[: len(known)])
    _log_solution(len(known), solution, cost, statement)
    return SolvedGraph(Poses(known, matrices, spread), verdicts, part, cost, statement)


def _solved(stated: StatedSystem, config: GraphConfig) -> RobustSolution:
    system, start = stated.system, stated.start
    trusted = stated.trusted if config.robust else np.ones_like(stated.trusted)
    if len(trusted) == 0 or system.size == 0:
        return RobustSolution.untouched(system, start)
    solution = solve_robustly(system, start, stated.anchors, trusted, config)
    part = believed_edges(system, solution.inliers)
    poses = optimised_roughly(part, solution.poses, config.tolerance)
    return replace(solution, poses=poses, chi2=edge_chi2(system, poses))


def _log_solution(nodes: int, solution: RobustSolution, cost: float, statement: str) -> None:
    believed = solution.inliers[solution.closures]
    closures = f"{believed.sum()} of {believed.size} closures"
    decided("graph", f"{nodes} nodes solved, {closures} believed, cost {cost:.6g}; {statement}")


def component_losses(count: int) -> list[str]:
    """A line where a graph has several components; else none."""
    if count < 2:
        return []
    return [f"The graph has {count} components that no constraint connects."]
