"""Covariances against dense inverses and against what a chain must give."""

from __future__ import annotations

from dataclasses import replace

import gtsam
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.linalg import expm
from scipy.sparse import csc_array

from mapmyworld.backend.factors import factor_graph
from mapmyworld.backend.information import (
    Factorised,
    NotPositiveDefiniteError,
    Variables,
    information_of,
)
from mapmyworld.backend.predictions import predictions
from mapmyworld.backend.residuals import retract
from mapmyworld.backend.system import (
    System,
    believed_edges,
    chosen_edges,
    fit_of,
    number_free,
)
from mapmyworld.errors import GraphError
from mapmyworld.geometry.planar import (
    between_planar,
    compose_planar,
    information_from_planar,
    planar_adjoint,
    planar_to_matrix,
)
from mapmyworld.geometry.rigid import between as rigid
from mapmyworld.geometry.rigid import se3_adjoint, se3_exp
from mapmyworld.geometry.rotations import skew
from mapmyworld.graph.covariance import (
    RelativeCovariances,
    marginal_covariances,
    relative_pose,
)
from mapmyworld.graph.solved_graph import solve
from mapmyworld.types import ConstraintKind, Judged
from mapmyworld.types.pose_graph import Edges, PoseGraph


def random_system(planar: bool, count: int, extra: int, seed: int) -> tuple[System, np.ndarray]:
    """A chain with random further edges, noisy measurements, and true poses."""
    rng = np.random.default_rng(seed)
    size = 3 if planar else 6
    if planar:
        poses = rng.normal(size=(count, 3))
    else:
        poses = se3_exp(rng.normal(size=(count, 6)))
    chain = np.arange(count - 1)
    more = rng.integers(0, count, (extra, 2))
    more = more[more[:, 0] != more[:, 1]]
    tails = np.concatenate([chain, more[:, 0]])
    heads = np.concatenate([chain + 1, more[:, 1]])
    noise = rng.normal(size=(len(tails), size)) * 0.05
    between = between_planar if planar else rigid
    measured = retract(planar, between(poses[tails], poses[heads]), noise)
    root = rng.normal(size=(len(tails), size, size))
    information = root @ np.swapaxes(root, 1, 2) + np.eye(size)
    free = number_free(np.arange(count) == 0)
    return System(planar, tails, heads, measured, information, free), poses


def rows_of(system: System, poses: np.ndarray, k: int) -> np.ndarray:
    """The derivative (d, n) of an edge's residual in sigmas by the tangents of all free nodes."""
    one = chosen_edges(system, np.array([k]))
    variables, part = Variables.of(factor_graph(system, poses).values), factor_graph(one, poses)
    return variables.jacobian(part.factors.linearize(part.values))[0].toarray()


def dense_information(system: System, poses: np.ndarray) -> np.ndarray:
    """The information over all nodes but the first, edge by edge."""
    rows = [rows_of(system, poses, k) for k in range(len(system.tails))]
    return sum(one.T @ one for one in rows)


def right_jacobian(planar: bool, tangent: np.ndarray) -> np.ndarray:
    """(d, d) how the logarithm moves the motion: the integral of `exp(-s ad)` for s from 0 to 1,
    which is a block of the exponential of a matrix twice as large.
    """
    size = len(tangent)
    twice = np.zeros((2 * size, 2 * size))
    if planar:
        x, y, yaw = tangent
        twice[:size, :size] = -np.array([[0.0, -yaw, y], [yaw, 0.0, -x], [0.0, 0.0, 0.0]])
    else:
        twice[:3, :3] = twice[3:6, 3:6] = -skew(tangent[:3])
        twice[3:6, :3] = -skew(tangent[3:])
    twice[:size, size:] = np.eye(size)
    return expm(twice)[:size, size:]


@pytest.mark.parametrize("planar", [True, False])
def test_derivatives_of_edges_are_those_of_the_logarithm(planar: bool) -> None:
    """`log(m^-1 t^-1 h)` changes with h by the inverse of its right Jacobian."""
    system, poses = random_system(planar, 12, 10, 5)
    between, adjoint = (between_planar, planar_adjoint) if planar else (rigid, se3_adjoint)
    size, residuals = system.dimension, fit_of(system, poses).residuals
    for k in np.flatnonzero((system.tails > 0) & (system.heads > 0)).tolist():
        tail, head = poses[system.tails[[k]]], poses[system.heads[[k]]]
        by_head = np.linalg.inv(right_jacobian(planar, residuals[k]))
        expected = np.zeros((size, len(poses), size))
        expected[:, system.heads[k]] = by_head
        expected[:, system.tails[k]] = -by_head @ adjoint(between(head, tail))[0]
        whitened = rows_of(system, poses, k)
        found = np.linalg.solve(np.linalg.cholesky(system.information[k]).T, whitened)
        assert np.allclose(found, expected[:, 1:].reshape(size, -1), atol=1e-7)


@settings(max_examples=20)
@given(st.booleans(), st.integers(2, 60), st.integers(0, 80), st.integers(0, 10**6))
def test_groups_of_edges_vary_together_as_the_dense_inverse_says(planar, count, extra, seed):
    """Also edges that the solution has not seen, and groups that span the whole graph."""
    rng = np.random.default_rng(seed)
    system, poses = random_system(planar, count, extra, seed)
    every = np.arange(len(system.tails))
    seen = (every < count - 1) | (rng.random(len(every)) < 0.5)
    dense = np.linalg.inv(dense_information(chosen_edges(system, seen), poses))
    groups = np.split(rng.permutation(every), np.unique(rng.integers(1, len(every) + 1, 4)))
    groups = [group for group in groups if len(group)]
    found = predictions(information_of(chosen_edges(system, seen), poses), system, poses, groups)
    for group, one in zip(groups, found, strict=True):
        rows = np.concatenate([rows_of(system, poses, k) for k in group])
        expected = rows @ dense @ rows.T
        assert np.allclose(one.covariance, expected, rtol=1e-6, atol=1e-9 * np.abs(expected).max())
        if (system.heads[group] > 0).all():  # the residual of an edge into a held node is turned
            roots = np.linalg.cholesky(system.information[group])
            missed = np.einsum("eji,ej->ei", roots, fit_of(system, poses).residuals[group])
            assert np.allclose(one.residuals, missed.ravel())


@settings(max_examples=25)
@given(st.booleans(), st.integers(2, 60), st.integers(0, 80), st.integers(0, 10**6))
def test_solutions_and_marginals_are_those_of_the_dense_matrix(planar, count, extra, seed):
    system, poses = random_system(planar, count, extra, seed)
    size = system.dimension
    dense = np.linalg.inv(dense_information(system, poses))
    found = marginal_covariances(system, poses)
    assert found is not None
    tiles = dense.reshape(count - 1, size, count - 1, size)
    expected = tiles[np.arange(count - 1), :, np.arange(count - 1), :]
    assert np.allclose(found[1:], expected, rtol=1e-7, atol=1e-10 * np.abs(dense).max())
    assert not found[0].any()


def test_a_straight_chain_gathers_variance_as_theory_says():
    """Steps of 1 m with sigmas s and a: at k steps, x and yaw vary as k s^2 and k a^2; y as
    k s^2 + a^2 (0^2 + 1^2 + ... + (k-1)^2), each turn acting over what is left of the way.
    """
    s, a, count = 0.1, 0.02, 11
    information = information_from_planar(np.diag([s**-2, s**-2, a**-2]))
    motion = planar_to_matrix(np.array([1.0, 0, 0]))
    made = [
        Judged(k, k + 1, ConstraintKind.NEIGHBOUR, motion, information) for k in range(1, count)
    ]
    truth = planar_to_matrix(np.c_[np.arange(count), np.zeros((count, 2))])
    solved = solve(np.arange(1, count + 1), truth, made, planar=True)
    spread = solved.poses.covariances
    assert spread is not None
    k = np.arange(count)
    assert np.allclose(spread[:, 3, 3], k * s**2)
    assert np.allclose(spread[:, 2, 2], k * a**2)
    lever = np.array([sum(j * j for j in range(n)) for n in k])
    assert np.allclose(spread[:, 4, 4], k * s**2 + a**2 * lever)


def test_a_relative_covariance_of_neighbours_in_a_chain_is_the_edges_own():
    system, poses = random_system(True, 30, 0, 3)
    motion = system.measured.copy()
    for k in range(29):
        poses[k + 1] = retract(True, poses[k : k + 1], np.zeros((1, 3)))[0]
        poses[k + 1] = compose_planar(poses[k], motion[k])
    found = RelativeCovariances.of(system, poses).between(np.array([4, 20]), np.array([5, 21]))
    assert np.allclose(found, np.linalg.inv(system.information[[4, 20]]))


def chain(count: int, sigma: float) -> PoseGraph:
    """Nodes 10, 11, ... a metre apart on a line, each step and turn sure to `sigma`."""
    ids = np.arange(10, 10 + count)
    information = np.broadcast_to(np.eye(3) / sigma**2, (count - 1, 3, 3))
    steps = np.tile([1.0, 0.0, 0.0], (count - 1, 1))
    edges = Edges(ids[:-1], ids[1:], steps, information, np.ones(count - 1, np.bool_))
    poses = np.stack([np.arange(count), np.zeros(count), np.zeros(count)], 1)
    return PoseGraph(True, ids, poses, edges)


def test_relative_poses_of_a_chain_add_up():
    """Along the line variances add; across it each turn counts with its lever arm to the end."""
    pose, covariance = relative_pose(chain(8, 0.01), 12, 15)
    assert np.allclose(pose[:3, 3], [3.0, 0.0, 0.0])
    assert covariance[3, 3] == pytest.approx(3 * 1e-4)
    assert covariance[2, 2] == pytest.approx(3 * 1e-4)
    assert covariance[4, 4] == pytest.approx((3 + 2**2 + 1**2) * 1e-4)


def test_relative_poses_are_as_uncertain_as_by_gtsams_marginals():
    """A chain with a closure: `J Sigma J'` of the joint marginal of both ends, by gtsam alone."""
    graph, ids = chain(6, 0.05), (11, 14)
    loop = Edges(
        np.array([10]), np.array([15]), np.array([[5.0, 0.0, 0.0]]), 1e3 * np.eye(3)[None],
        np.zeros(1, np.bool_),
    )  # fmt: skip
    both = [np.concatenate([getattr(e, n) for e in (graph.edges, loop)])
            for n in ("from_ids", "to_ids", "i_from_j", "information", "odometry")]  # fmt: skip
    graph = replace(graph, edges=Edges(*both))
    factors, values = gtsam.NonlinearFactorGraph(), gtsam.Values()
    for node, pose in zip(graph.ids.tolist(), graph.map_from_node, strict=True):
        values.insert(node, gtsam.Pose2(*pose))
    first = gtsam.noiseModel.Isotropic.Sigma(3, 1e-3)
    factors.add(gtsam.PriorFactorPose2(10, values.atPose2(10), first))
    for tail, head, motion, information, _ in zip(*both, strict=True):
        noise = gtsam.noiseModel.Gaussian.Information(information)
        factors.add(gtsam.BetweenFactorPose2(int(tail), int(head), gtsam.Pose2(*motion), noise))
    joint = gtsam.Marginals(factors, values).jointMarginalCovariance(list(ids)).fullMatrix()
    step = values.atPose2(ids[0]).between(values.atPose2(ids[1]))
    rows = np.hstack([-step.inverse().AdjointMap(), np.eye(3)])
    _, covariance = relative_pose(graph, *ids)
    assert np.allclose(covariance[np.ix_([3, 4, 2], [3, 4, 2])], rows @ joint @ rows.T, rtol=1e-6)


def test_relative_poses_that_cannot_be_are_refused():
    graph = chain(4, 0.1)
    with pytest.raises(GraphError, match="no node 99"):
        relative_pose(graph, 10, 99)
    parted = replace(graph, edges=graph.edges.chosen(np.array([0, 2])))
    with pytest.raises(GraphError, match="separate components"):
        relative_pose(parted, 10, 13)


def test_a_matrix_that_is_not_definite_is_refused():
    with pytest.raises(NotPositiveDefiniteError):
        Factorised.of(csc_array([[1.0, 2.0], [2.0, 1.0]]), np.array([1, 0]))
    with pytest.raises(NotPositiveDefiniteError):
        Factorised.of(csc_array([[1.0, 1.0], [1.0, 1.0]]), np.array([0, 1]))


@settings(max_examples=15)
@given(st.booleans(), st.integers(2, 60), st.integers(0, 80), st.integers(0, 10**6))
def test_edges_together_are_as_sure_as_each_for_itself(
    planar: bool, count: int, extra: int, seed: int
) -> None:
    """Also where several nodes stay, and where what is believed falls into parts."""
    rng = np.random.default_rng(seed)
    system, poses = random_system(planar, count, extra, seed)
    system = replace(system, free=number_free((rng.random(count) < 0.1) | (np.arange(count) == 0)))
    part = believed_edges(system, rng.random(len(system.tails)) < 0.8)
    if part.size == 0:
        return
    information, tested = information_of(part, poses), replace(system, free=part.free)
    every = np.arange(len(system.tails))
    together = predictions(information, tested, poses, [every])[0]
    alone = predictions(information, tested, poses, list(every.reshape(-1, 1)))
    size = system.dimension
    tiles = together.covariance.reshape(len(every), size, len(every), size)
    found = np.stack([one.covariance for one in alone])
    assert np.allclose(tiles[every, :, every], found, rtol=1e-9, atol=1e-12 * np.abs(found).max())
