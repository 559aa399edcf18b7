"""How uncertain nodes are: marginal covariances of all, relative covariances of pairs."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from mapmyworld.backend.connected_components import positions
from mapmyworld.backend.information import (
    Information,
    NotPositiveDefiniteError,
    information_of,
)
from mapmyworld.backend.predictions import predictions
from mapmyworld.backend.system import System, chosen_edges
from mapmyworld.errors import GraphError
from mapmyworld.geometry import Array, Index
from mapmyworld.geometry.planar import between_planar, covariance_from_planar, planar_to_matrix
from mapmyworld.geometry.rigid import between, invert, se3_adjoint
from mapmyworld.graph.problem import Problem, problem_of
from mapmyworld.types.pose_graph import PoseGraph


def marginal_covariances(system: System, poses: Array) -> Array | None:
    """(N, d, d) covariance of every node in its own frame, given the fixed ones; zero for those.

    By `poses` (N, 3 or 4, 4), map_from_node. None where the edges leave a node undetermined.
    """
    size, free = system.dimension, np.flatnonzero(system.free >= 0)
    covariances = np.zeros((len(system.free), size, size))
    if len(free) == 0:
        return covariances
    try:
        found = information_of(system, poses).marginals(free)
    except NotPositiveDefiniteError:
        return None
    places = slice(0, 2) if system.planar else slice(3, 6)
    points = system.points[free]
    covariances[free[~points]] = [found[k] for k in np.flatnonzero(~points).tolist()]
    if points.any():
        covariances[free[points], places, places] = [
            found[k] for k in np.flatnonzero(points).tolist()
        ]
    return covariances


def graph_covariances(graph: PoseGraph, accepted: NDArray[np.bool_]) -> Array | None:
    """(N + L, 6, 6) covariances of a solved graph's nodes, then landmarks, rotation first.

    By edges that are `accepted` (E,). None where the edges leave a node undetermined.
    """
    problem = problem_of(graph)
    poses, count = _solved(problem), len(graph)
    believed = np.ones(len(problem.system.tails), np.bool_)
    believed[: len(accepted)] = accepted[problem.order]
    found = marginal_covariances(chosen_edges(problem.system, believed), poses)
    return None if found is None else spatial_covariances(graph.planar, np.delete(found, count, 0))


def relative_pose(
    graph: PoseGraph, from_id: int, to_id: int, own: Array | None = None
) -> tuple[Array, Array]:
    """i_from_j (4, 4) of a solved graph, and its covariance (6, 6) in to's frame.

    The graph shows how scans lie to each other: each node errs by its `own` noise (6, 6) as well.
    Raises `GraphError` for nodes that the graph lacks, does not link or leaves undetermined.
    """
    problem = problem_of(graph)
    at = positions(graph.ids, np.array([from_id, to_id]))
    for node_id, index in zip((from_id, to_id), at, strict=True):
        if index < 0:
            known = f"{graph.ids.min()} to {graph.ids.max()}"
            raise GraphError(f"the graph has no node {node_id}: it has {known}")
    if problem.component[at[0]] != problem.component[at[1]]:
        raise GraphError(
            f"nothing links nodes {from_id} and {to_id}: they lie in separate components"
        )
    poses = _solved(problem)
    try:
        covariance = RelativeCovariances.of(problem.system, poses).between(at[:1], at[1:])
    except NotPositiveDefiniteError:
        raise GraphError("the accepted constraints leave a node undetermined") from None
    step = between_planar if graph.planar else between
    motion = step(poses[at[0]], poses[at[1]])
    whole = planar_to_matrix(motion) if graph.planar else motion
    spread = spatial_covariances(graph.planar, covariance)[0]
    if own is not None:
        carry = se3_adjoint(invert(whole))
        spread = spread + own + carry @ own @ carry.T
    return whole, spread


def _solved(problem: Problem) -> Array:
    """The graph's poses as they stand: nodes, the map's own frame, landmarks."""
    graph, poses = problem.graph, problem.guess.copy()
    size = 2 if graph.planar else 3
    column = (slice(None), slice(0, 2)) if graph.planar else (slice(None), slice(0, 3), 3)
    poses[len(graph) + 1 :][column] = graph.landmarks[:, :size]
    return poses


@dataclass(frozen=True, slots=True, eq=False)
class RelativeCovariances:
    """What a solution knows of motions between pairs of its nodes."""

    system: System
    poses: Array
    """(N, 3 or 4, 4) map_from_node."""
    information: Information

    @staticmethod
    def of(system: System, poses: Array) -> RelativeCovariances:
        """By a system's edges at `poses` (N, 3 or 4, 4), map_from_node.

        Raises `NotPositiveDefiniteError` where the edges leave a node undetermined.
        """
        return RelativeCovariances(system, poses, information_of(system, poses))

    def between(self, tails: Index, heads: Index) -> Array:
        """(P, d, d) covariance of motions from nodes `tails` (P,) to nodes `heads` (P,).

        In the frames of the heads.
        """
        system, poses = self.system, self.poses
        step = between_planar if system.planar else between
        exact = np.tile(np.eye(system.dimension), (len(tails), 1, 1))
        asked = replace(
            system, tails=tails, heads=heads, measured=step(poses[tails], poses[heads]),
            information=exact, kinds=None,
        )  # fmt: skip
        alone = list(np.arange(len(tails)).reshape(-1, 1))
        found = predictions(self.information, asked, poses, alone)
        return np.array([one.covariance for one in found]).reshape(exact.shape)


def spatial_covariances(planar: bool, covariances: Array) -> Array:
    """(N, 6, 6), rotation first, of `covariances` (N, d, d), d = 3 or 6.

    A planar one knows height, roll and pitch exactly.
    """
    return covariance_from_planar(covariances) if planar else covariances
