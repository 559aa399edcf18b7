"""Constraints as gtsam's factors: the same residuals, whichever end stays, and a descent."""

from __future__ import annotations

from dataclasses import replace

import gtsam
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.optimize import approx_fprime

from mapmyworld.backend.block_matrix import edge_blocks
from mapmyworld.backend.descent import descend, solved
from mapmyworld.backend.factors import between_factors, factor_graph, poses_of
from mapmyworld.backend.information import information_of
from mapmyworld.backend.landmarks import POINT, POLAR, sighting_residuals
from mapmyworld.backend.residuals import edge_residuals, retract
from mapmyworld.backend.starts import nearest_rotations
from mapmyworld.backend.system import System, fit_of, number_free, with_edges
from mapmyworld.geometry import Array
from mapmyworld.geometry.planar import between_planar, planar_exp
from mapmyworld.geometry.rigid import between, se3_exp
from tests.test_graph_covariance import random_system


def edges(planar: bool, angle: float, seed: int) -> tuple[Array, Array, Array, Array]:
    """Poses of tails and heads, measured motions, and the residuals these were made with."""
    rng = np.random.default_rng(seed)
    size, count = (3 if planar else 6), 5
    pose = planar_exp if planar else se3_exp
    tail, head = (pose(rng.normal(size=(count, size))) for _ in range(2))
    axis = rng.normal(size=(count, 1 if planar else 3))
    axis *= angle / np.linalg.norm(axis, axis=1, keepdims=True)
    shift = rng.normal(size=(count, 2 if planar else 3))
    wanted = np.hstack([shift, axis] if planar else [axis, shift])
    motion = (between_planar if planar else between)(tail, head)
    return tail, head, retract(planar, motion, -wanted), wanted


@settings(max_examples=60)
@given(st.booleans(), st.floats(0.0, 3.14159), st.integers(0, 1000))
def test_residuals_undo_the_exponential(planar: bool, angle: float, seed: int) -> None:
    tail, head, measured, wanted = edges(planar, angle, seed)
    assert np.allclose(edge_residuals(planar, tail, head, measured), wanted, atol=1e-9)


@settings(max_examples=30)
@given(st.booleans(), st.integers(2, 20), st.integers(0, 30), st.integers(0, 1000))
def test_gtsam_costs_what_the_arrays_cost(planar: bool, count: int, extra: int, seed: int) -> None:
    """Whichever nodes stay: an edge into one is turned around, one between two is left out."""
    system, poses = random_system(planar, count, extra, seed)
    stays = np.random.default_rng(seed).random(count) < 0.3
    stays[0] = True
    system = replace(system, free=number_free(stays))
    graph, fit = factor_graph(system, poses), fit_of(system, poses)
    between_held = stays[system.tails] & stays[system.heads]
    assert graph.factors.size() == np.count_nonzero(~between_held)
    expected = 0.5 * fit.squares[~between_held].sum()
    assert graph.factors.error(graph.values) == pytest.approx(expected, rel=1e-9)
    found = poses_of(system, graph.values, poses)
    apart = between_planar(found, poses) if planar else between(found, poses) - np.eye(4)
    assert np.abs(apart).max() < 1e-12


def test_factors_that_were_kept_are_not_those_of_other_edges() -> None:
    system, poses = random_system(True, 8, 6, 3)
    kept = replace(system, factors=between_factors(system))
    assert factor_graph(kept, poses).factors.size() == len(system.tails)
    ends = np.array([0, 1]), np.array([6, 7])
    more = with_edges(kept, *ends, np.zeros((2, 3)), np.tile(np.eye(3), (2, 1, 1)))
    graph = factor_graph(more, poses)
    assert graph.factors.size() == len(system.tails) + 2
    assert graph.factors.error(graph.values) == pytest.approx(fit_of(more, poses).cost)


@pytest.mark.parametrize("planar", [True, False])
def test_a_descent_ends_where_the_slope_is_zero(planar: bool) -> None:
    system, poses = random_system(planar, 30, 40, 3)
    end = descend(system, fit_of(system, poses), 1e-10, 100)
    assert end.converged
    assert end.fit.cost < fit_of(system, poses).cost
    assert np.array_equal(end.fit.poses[0], poses[0])
    rng = np.random.default_rng(0)
    for _ in range(5):
        way = 1e-4 * rng.normal(size=(30, system.dimension)) * (np.arange(30) > 0)[:, None]
        for sign in (1.0, -1.0):
            moved = retract(planar, end.fit.poses, sign * way)
            assert fit_of(system, moved).cost >= end.fit.cost * (1 - 1e-9)


def test_gtsams_own_marginals_are_ours() -> None:
    system, poses = random_system(False, 25, 30, 4)
    graph = factor_graph(system, poses)
    theirs = gtsam.Marginals(graph.factors, graph.values)
    ours = information_of(system, poses).marginals(np.arange(1, 25))
    for key, found in enumerate(ours, 1):
        assert np.allclose(found, theirs.marginalCovariance(key), rtol=1e-8, atol=1e-12)


def test_the_same_graph_gives_the_same_bytes() -> None:
    system, poses = random_system(True, 200, 300, 5)
    ends = [descend(system, fit_of(system, poses), 1e-9, 50).fit.poses for _ in range(3)]
    assert all(end.tobytes() == ends[0].tobytes() for end in ends)


def test_more_factors_and_variables_may_be_added() -> None:
    """A prior on the last node and a variable of its own kind, without touching the solver."""
    system, poses = random_system(True, 10, 0, 6)
    graph = factor_graph(system, poses)
    wanted = gtsam.Pose2(5.0, 0.0, 0.0)
    graph.factors.add(gtsam.PriorFactorPose2(9, wanted, gtsam.noiseModel.Isotropic.Sigma(3, 1e-4)))
    bias = gtsam.symbol("b", 0)
    graph.values.insert(bias, np.array([0.0, 0.0, 0.0]))
    graph.factors.add(
        gtsam.PriorFactorVector(bias, np.ones(3), gtsam.noiseModel.Isotropic.Sigma(3, 1.0))
    )
    values = solved(graph).values
    assert np.allclose(poses_of(system, values, poses)[9], [5.0, 0.0, 0.0], atol=1e-3)
    assert np.allclose(values.atVector(bias), 1.0)


@pytest.mark.parametrize("held", [False, True])
@pytest.mark.parametrize(("planar", "kind"), [(True, POINT), (True, POLAR), (False, POINT)])
def test_factors_of_sightings_have_their_errors_and_slopes(
    planar: bool, kind: int, held: bool
) -> None:
    rng = np.random.default_rng(1)
    size, freedom = (2, 3) if planar else (3, 6)
    places = slice(0, 2) if planar else slice(3, 6)
    node = planar_exp(rng.normal(size=3)) if planar else se3_exp(rng.normal(size=6))
    head, measured = np.zeros((2, 3)) if planar else np.stack([np.eye(4)] * 2)
    point = rng.normal(size=size)
    _placed(planar, head, point)
    _placed(planar, measured, rng.normal(size=size))

    def error(step: np.ndarray) -> np.ndarray:
        """Of the sighting once the node and the point have moved."""
        there = head.copy()
        _placed(planar, there, point + step[freedom:])
        moved = retract(planar, node[None], step[None, :freedom])
        given = moved, there[None], measured[None], np.array([kind])
        return sighting_residuals(planar, *given)[0, places]

    free = number_free(np.array([held, False]))
    ends = np.array([0]), np.array([1])
    weights = np.eye(freedom)[None]
    system = System(planar, *ends, measured[None], weights, free, np.array([kind]))
    graph = factor_graph(system, np.stack([node, head]))
    derivatives, less = graph.factors.linearize(graph.values).jacobian()
    still = np.zeros(freedom + size)
    assert np.allclose(error(still), -less)
    slopes = approx_fprime(still, error, 1e-7)
    assert np.allclose(slopes[:, freedom if held else 0 :], derivatives, atol=1e-5)


def _placed(planar: bool, pose: np.ndarray, point: np.ndarray) -> None:
    """Moves a pose (3,) or (4, 4) to a point (2,) or (3,)."""
    pose[np.s_[:2] if planar else np.s_[:3, 3]] = point


@settings(max_examples=30)
@given(st.sampled_from([1, 3, 4]), st.integers(0, 1000))
def test_blocks_of_edges_are_those_of_the_dense_matrix(size: int, seed: int) -> None:
    rng = np.random.default_rng(seed)
    nodes, count = 5, 9
    tails = rng.integers(0, nodes, count)
    heads = (tails + rng.integers(1, nodes, count)) % nodes
    turns, root = rng.normal(size=(2, count, size, size))
    weights = root @ np.swapaxes(root, 1, 2)
    dense = np.zeros((nodes, size, nodes, size))
    for e in range(count):
        dense[tails[e], :, tails[e]] += turns[e] @ weights[e] @ turns[e].T
        dense[heads[e], :, heads[e]] += weights[e]
        dense[tails[e], :, heads[e]] -= turns[e] @ weights[e]
        dense[heads[e], :, tails[e]] -= weights[e] @ turns[e].T
    found = edge_blocks(nodes, tails, heads, turns, weights).matrix.toarray()
    assert np.allclose(found, dense.reshape(found.shape))


@pytest.mark.parametrize("size", [2, 3])
def test_nearest_rotations_are_those_of_the_singular_values(size: int) -> None:
    """Also of matrices that mirror, and of those that are rotations already."""
    matrices = np.random.default_rng(4).normal(size=(500, size, size))
    left, _, right = np.linalg.svd(matrices)
    left[..., -1] *= np.linalg.det(left @ right)[:, None]
    nearest = nearest_rotations(matrices)
    assert np.allclose(nearest, left @ right, atol=1e-9)
    assert np.allclose(nearest_rotations(3.0 * nearest), nearest, atol=1e-12)
