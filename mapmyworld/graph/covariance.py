"""How uncertain nodes are: marginal covariances of all, relative covariances of pairs."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from mapmyworld.geometry import PLANAR_IN_TANGENT, Array, between, between_planar
from mapmyworld.graph.cholesky import NotPositiveDefiniteError, analyse, factorise
from mapmyworld.graph.pose_graph import Index
from mapmyworld.graph.problem import problem_of
from mapmyworld.graph.system import (
    System,
    chosen_edges,
    jacobians_of,
    predicted_covariances,
    residuals_of,
)
from mapmyworld.types.pose_graph import PoseGraph


def marginal_covariances(system: System, poses: Array) -> Array | None:
    """(N, d, d) covariance of every node in its own frame, given the fixed ones; zero for those.

    None where the edges leave a node undetermined.
    """
    rows, columns, blocks = information_blocks(system, poses)
    count = system.size // system.dimension
    covariances = np.zeros((len(system.free), system.dimension, system.dimension))
    if count == 0:
        return covariances
    try:
        factors = factorise(analyse(count, rows, columns, system.dimension), blocks)
    except NotPositiveDefiniteError:
        return None
    covariances[system.free >= 0] = factors.marginals()
    return covariances


def graph_covariances(graph: PoseGraph, accepted: NDArray[np.bool_]) -> Array | None:
    """(N + L, 6, 6) covariances of a solved graph's nodes, then landmarks, by `accepted` edges.

    None where the edges leave a node undetermined.
    """
    problem = problem_of(graph)
    poses, count = problem.guess.copy(), len(graph)
    size = 2 if graph.planar else 3
    column = (slice(None), slice(0, 2)) if graph.planar else (slice(None), slice(0, 3), 3)
    poses[count + 1 :][column] = graph.landmarks[:, :size]
    believed = np.ones(len(problem.system.tails), np.bool_)
    believed[: len(accepted)] = accepted[problem.order]
    found = marginal_covariances(chosen_edges(problem.system, believed), poses)
    return None if found is None else spatial_covariances(graph.planar, np.delete(found, count, 0))


def relative_covariances(system: System, poses: Array, tails: Index, heads: Index) -> Array:
    """(P, d, d) covariance of the motions between pairs of nodes, in the second node's frame.

    Raises `NotPositiveDefiniteError` where the edges leave a node undetermined.
    """
    rows, columns, blocks = information_blocks(system, poses)
    factors = factorise(
        analyse(system.size // system.dimension, rows, columns, system.dimension), blocks
    )
    step = between_planar if system.planar else between
    asked = replace(system, tails=tails, heads=heads, measured=step(poses[tails], poses[heads]))
    return predicted_covariances(factors, asked, poses)[0]


def information_blocks(system: System, poses: Array) -> tuple[Index, Index, Array]:
    """Rows, columns and blocks (B, d, d) of the information matrix, each pair of nodes once."""
    by_tail, by_head = jacobians_of(system, poses, residuals_of(system, poses))
    left, right = (np.swapaxes(j, 1, 2) @ system.information for j in (by_tail, by_head))
    a, b = system.free[system.tails], system.free[system.heads]
    both, turned = (a >= 0) & (b >= 0), a > b
    cross = left @ by_head
    cross[turned] = np.swapaxes(cross[turned], 1, 2)
    count, size = system.size // system.dimension, system.dimension
    diagonal = np.arange(count)
    keys = np.concatenate(
        [
            diagonal * (count + 1),
            a[a >= 0] * (count + 1),
            b[b >= 0] * (count + 1),
            (np.minimum(a, b) * count + np.maximum(a, b))[both],
        ]
    )
    parts = [np.zeros((count, size, size)), (left @ by_tail)[a >= 0], (right @ by_head)[b >= 0]]
    unique, slot = np.unique(keys, return_inverse=True)
    blocks = np.zeros((len(unique), size, size))
    np.add.at(blocks, slot, np.concatenate([*parts, cross[both]]))
    return unique // count, unique % count, blocks


def spatial_covariances(planar: bool, covariances: Array) -> Array:
    """(N, 6, 6), rotation first; a planar one knows height, roll and pitch exactly."""
    if not planar:
        return covariances
    full = np.zeros((len(covariances), 6, 6))
    full[:, PLANAR_IN_TANGENT[:, None], PLANAR_IN_TANGENT] = covariances
    return full
