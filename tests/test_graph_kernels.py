"""The kernels of edges and their equations against plain twins."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from mapmyworld.geometry import Array
from mapmyworld.geometry.planar import between_planar, compose_planar
from mapmyworld.geometry.rigid import between, se3_adjoint, se3_exp, se3_log
from mapmyworld.geometry.rotations import skew
from mapmyworld.graph.elimination import links
from mapmyworld.graph.normal_equations import edge_blocks
from mapmyworld.graph.residuals import (
    edge_jacobians,
    edge_residuals,
    planar_adjoint,
    planar_exp,
    planar_log,
    retract,
)
from mapmyworld.kernels.normal_equations import add_edges, add_product

# Bernoulli numbers over factorials: the inverse Jacobian of the exponential map as a series.
SERIES = (1 / 12, -1 / 720, 1 / 30240, -1 / 1209600, 1 / 47900160, -691 / 1307674368000)


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
    found = edge_residuals(planar, tail, head, measured)
    assert np.allclose(found, wanted, atol=1e-9)


@pytest.mark.parametrize("planar", [True, False])
@pytest.mark.parametrize("angle", [1e-9, 3e-6, 2e-5, 9e-4, 1.1e-3, 0.5, 2.0, 2.1, 3.0])
def test_residuals_are_those_of_plain_arrays(planar: bool, angle: float) -> None:
    tail, head, measured, _ = edges(planar, angle, 7)
    if planar:
        twin = planar_log(between_planar(measured, between_planar(tail, head)))
    else:
        twin = se3_log(between(measured, between(tail, head)))
    assert np.allclose(edge_residuals(planar, tail, head, measured), twin, rtol=1e-11, atol=1e-13)


def small_adjoint(planar: bool, tangents: Array) -> Array:
    """The derivative of the adjoint along tangents."""
    size = tangents.shape[1]
    found = np.zeros((len(tangents), size, size))
    if planar:
        x, y, yaw = tangents.T
        found[:, 0, 1], found[:, 1, 0], found[:, 0, 2], found[:, 1, 2] = -yaw, yaw, y, -x
        return found
    found[:, :3, :3] = found[:, 3:, 3:] = skew(tangents[:, :3])
    found[:, 3:, :3] = skew(tangents[:, 3:])
    return found


@pytest.mark.parametrize("planar", [True, False])
@pytest.mark.parametrize("angle", [0.0, 1e-9, 5e-5, 2e-4, 0.01, 1.0, 3.1, 6.0])
def test_poses_move_by_the_exponential(planar: bool, angle: float) -> None:
    poses, _, _, tangents = edges(planar, angle, 5)
    wanted = compose_planar(poses, planar_exp(tangents)) if planar else poses @ se3_exp(tangents)
    assert np.allclose(retract(planar, poses, tangents), wanted, atol=2e-12)


@settings(max_examples=60)
@given(st.booleans(), st.floats(0.0, 1.0), st.integers(0, 1000))
def test_jacobians_are_those_of_the_series(planar: bool, angle: float, seed: int) -> None:
    tail, head, _, residuals = edges(planar, angle, seed)
    small = small_adjoint(planar, residuals)
    power = square = small @ small
    wanted = np.eye(small.shape[1]) + 0.5 * small
    for factor in SERIES:
        wanted = wanted + factor * power
        power = power @ square
    back = (between_planar if planar else between)(head, tail)
    adjoint = (planar_adjoint if planar else se3_adjoint)(back)
    by_tail, by_head = edge_jacobians(planar, tail, head, residuals)
    near = 1e-8 * float(np.abs(wanted).max())
    assert np.allclose(by_head, wanted, rtol=1e-8, atol=near)
    assert np.allclose(by_tail, -wanted @ adjoint, rtol=1e-8, atol=near)


@pytest.mark.parametrize("planar", [True, False])
@pytest.mark.parametrize("angle", [1.5, 2.5, 3.0])
def test_jacobians_are_slopes_where_the_series_is_poor(planar: bool, angle: float) -> None:
    tail, head, measured, _ = edges(planar, angle, 3)
    residuals = edge_residuals(planar, tail, head, measured)
    jacobians = edge_jacobians(planar, tail, head, residuals)
    for end, jacobian in enumerate(jacobians):
        for k, direction in enumerate(1e-6 * np.eye(residuals.shape[1])):
            step = np.tile(direction, (len(tail), 1))
            ends = [(tail, head), (tail, head)]
            for sign in (0, 1):
                moved = retract(planar, ends[sign][end], (1 - 2 * sign) * step)
                ends[sign] = (moved, head) if end == 0 else (tail, moved)
            there, back = (edge_residuals(planar, *poses, measured) for poses in ends)
            slope = (there - back) / 2e-6
            assert np.allclose(slope, jacobian[:, :, k], rtol=1e-5, atol=1e-5)


@settings(max_examples=30)
@given(st.sampled_from([3, 6]), st.booleans(), st.integers(0, 1000))
def test_normal_equations_are_those_of_the_dense_jacobian(
    size: int, weighted: bool, seed: int
) -> None:
    rng = np.random.default_rng(seed)
    nodes, count = 5, 9
    tails = rng.integers(0, nodes, count)
    heads = (tails + rng.integers(1, nodes, count)) % nodes
    by_tail, by_head, root = rng.normal(size=(3, count, size, size))
    information, residuals = root @ np.swapaxes(root, 1, 2), rng.normal(size=(count, size))
    weights = rng.uniform(0, 1, count) if weighted else np.empty(0)
    dense, gradient = np.zeros((nodes * size, nodes * size)), np.zeros(nodes * size)
    for e, share in enumerate(weights if weighted else np.ones(count)):
        whole = np.zeros((size, nodes * size))
        whole[:, tails[e] * size : (tails[e] + 1) * size] = by_tail[e]
        whole[:, heads[e] * size : (heads[e] + 1) * size] = by_head[e]
        dense += share * whole.T @ information[e] @ whole
        gradient += share * whole.T @ information[e] @ residuals[e]
    rows, columns, between_ends = links(nodes, tails, heads)
    blocks, found = np.zeros((len(rows), size, size)), np.zeros((nodes, size))
    given_arrays = tails, heads, between_ends, by_tail, by_head, information, residuals, weights
    add_edges(*given_arrays, blocks, found)
    tiles = dense.reshape(nodes, size, nodes, size)[rows, :, columns, :]
    assert np.allclose(blocks, tiles)
    assert np.allclose(found.ravel(), gradient)
    alone = np.zeros((nodes, size))
    add_edges(*given_arrays, np.empty((0, size, size)), alone)
    assert np.array_equal(alone, found)


@settings(max_examples=30)
@given(st.sampled_from([1, 3, 4]), st.integers(0, 1000))
def test_blocks_of_edges_are_those_of_the_dense_matrix(size: int, seed: int) -> None:
    rng = np.random.default_rng(seed)
    nodes, count = 5, 9
    tails = rng.integers(0, nodes, count)
    heads = (tails + rng.integers(1, nodes, count)) % nodes
    at_tail, at_head, across = rng.normal(size=(3, count, size, size))
    at_tail, at_head = (b + np.swapaxes(b, 1, 2) for b in (at_tail, at_head))
    dense = np.zeros((nodes, size, nodes, size))
    for e in range(count):
        dense[tails[e], :, tails[e]] += at_tail[e]
        dense[heads[e], :, heads[e]] += at_head[e]
        dense[tails[e], :, heads[e]] += across[e]
        dense[heads[e], :, tails[e]] += across[e].T
    rows, columns, blocks = edge_blocks(nodes, tails, heads, at_tail, at_head, across)
    assert np.allclose(blocks, dense[rows, :, columns])
    x = rng.normal(size=(nodes, 2, size))
    product = np.einsum("npi,nimj->mpj", x, dense)
    found = np.zeros(x.shape)
    add_product(x, rows, columns, blocks, found)
    assert np.allclose(found, product)
