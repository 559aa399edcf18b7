"""Covariances against dense inverses and against what a chain must give."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from mapmyworld.geometry import information_from_planar, planar_to_matrix, se3_exp
from mapmyworld.graph.cholesky import NotPositiveDefiniteError, analyse, factorise
from mapmyworld.graph.covariance import marginal_covariances, relative_covariances
from mapmyworld.graph.residuals import edge_jacobians, edge_residuals, retract
from mapmyworld.graph.solve import solve
from mapmyworld.graph.system import System, linearise, number_free, pattern_of
from mapmyworld.types import Constraint, ConstraintKind


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
    if planar:
        from mapmyworld.geometry import between_planar as between
    else:
        from mapmyworld.geometry import between
    measured = retract(planar, between(poses[tails], poses[heads]), noise)
    root = rng.normal(size=(len(tails), size, size))
    information = root @ np.swapaxes(root, 1, 2) + np.eye(size)
    free = number_free(count, np.array([0]))
    return System(planar, tails, heads, measured, information, free), poses


@settings(max_examples=25, deadline=None)
@given(st.booleans(), st.integers(2, 60), st.integers(0, 80), st.integers(0, 10**6))
def test_solutions_and_marginals_are_those_of_the_dense_matrix(planar, count, extra, seed):
    system, poses = random_system(planar, count, extra, seed)
    matrix, _ = linearise(system, pattern_of(system), poses)
    dense = np.linalg.inv(matrix.toarray())
    size = system.dimension
    found = marginal_covariances(system, poses)
    assert found is not None
    tiles = dense.reshape(count - 1, size, count - 1, size)
    expected = tiles[np.arange(count - 1), :, np.arange(count - 1), :]
    assert np.allclose(found[1:], expected, rtol=1e-7, atol=1e-10 * np.abs(dense).max())
    assert not found[0].any()


@pytest.mark.parametrize("planar", [True, False])
def test_jacobians_are_those_of_finite_differences(planar):
    system, poses = random_system(planar, 12, 10, 5)
    residuals = edge_residuals(planar, poses[system.tails], poses[system.heads], system.measured)
    by_tail, by_head = edge_jacobians(planar, poses[system.tails], poses[system.heads], residuals)
    step = 1e-6
    for ends, jacobian in ((system.tails, by_tail), (system.heads, by_head)):
        for k in range(system.dimension):
            tangent = np.zeros((len(ends), system.dimension))
            tangent[:, k] = step
            moved = retract(planar, poses[ends], tangent)
            tail = moved if ends is system.tails else poses[system.tails]
            head = moved if ends is system.heads else poses[system.heads]
            change = edge_residuals(planar, tail, head, system.measured) - residuals
            assert np.allclose(change / step, jacobian[:, :, k], atol=1e-4)


def test_a_straight_chain_gathers_variance_as_theory_says():
    """Steps of 1 m with sigmas s and a: at k steps, x and yaw vary as k s^2 and k a^2; y as
    k s^2 + a^2 (0^2 + 1^2 + ... + (k-1)^2), each turn acting over what is left of the way.
    """
    s, a, count = 0.1, 0.02, 11
    information = information_from_planar(np.diag([s**-2, s**-2, a**-2]))
    motion = planar_to_matrix(np.array([1.0, 0, 0]))
    made = [
        Constraint(k, k + 1, ConstraintKind.NEIGHBOUR, motion, information) for k in range(1, count)
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
        from mapmyworld.geometry import compose_planar

        poses[k + 1] = compose_planar(poses[k], motion[k])
    found = relative_covariances(system, poses, np.array([4, 20]), np.array([5, 21]))
    assert np.allclose(found, np.linalg.inv(system.information[[4, 20]]))


def test_a_matrix_that_is_not_definite_is_refused():
    symbolic = analyse(2, np.array([0, 0, 1]), np.array([0, 1, 1]), 1)
    with pytest.raises(NotPositiveDefiniteError):
        factorise(symbolic, np.array([1.0, 2.0, 1.0]).reshape(-1, 1, 1))
