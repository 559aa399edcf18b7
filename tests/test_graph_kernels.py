"""The kernels of edges and their equations against plain twins."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from mapmyworld.geometry import Array
from mapmyworld.geometry.planar import between_planar, compose_planar, planar_adjoint
from mapmyworld.geometry.rigid import between, se3_adjoint, se3_exp, se3_log
from mapmyworld.geometry.rotations import skew
from mapmyworld.graph.block_solver import solver_of
from mapmyworld.graph.certificate import derivatives
from mapmyworld.graph.cholesky import NotPositiveDefiniteError
from mapmyworld.graph.elimination import links
from mapmyworld.graph.normal_equations import weighted_blocks
from mapmyworld.graph.residuals import (
    edge_fits,
    edge_jacobians,
    edge_residuals,
    planar_exp,
    planar_log,
    retract,
)
from mapmyworld.graph.starts import nearest_rotations
from mapmyworld.graph.system import System, fit_of
from mapmyworld.graph.twin import (
    moved,
    multipliers,
    product,
    twin_cost,
    twin_of,
    twin_poses,
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


def jacobians(planar: bool, tail: Array, head: Array, residuals: Array) -> tuple[Array, Array]:
    """Derivatives of residuals between pairs of poses."""
    tails, heads = np.arange(2 * len(tail)).reshape(2, -1)
    return edge_jacobians(planar, np.concatenate([tail, head]), tails, heads, residuals)


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
    by_tail, by_head = jacobians(planar, tail, head, residuals)
    near = 1e-8 * float(np.abs(wanted).max())
    assert np.allclose(by_head, wanted, rtol=1e-8, atol=near)
    assert np.allclose(by_tail, -wanted @ adjoint, rtol=1e-8, atol=near)


@pytest.mark.parametrize("planar", [True, False])
@pytest.mark.parametrize("angle", [1.5, 2.5, 3.0])
def test_jacobians_are_slopes_where_the_series_is_poor(planar: bool, angle: float) -> None:
    tail, head, measured, _ = edges(planar, angle, 3)
    residuals = edge_residuals(planar, tail, head, measured)
    for end, jacobian in enumerate(jacobians(planar, tail, head, residuals)):
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
    free = np.where(rng.random(nodes) < 0.3, -1, np.arange(nodes))
    dense, gradient = np.zeros((nodes * size, nodes * size)), np.zeros(nodes * size)
    for e, share in enumerate(weights if weighted else np.ones(count)):
        whole = np.zeros((size, nodes * size))
        whole[:, tails[e] * size : (tails[e] + 1) * size] = by_tail[e]
        whole[:, heads[e] * size : (heads[e] + 1) * size] = by_head[e]
        dense += share * whole.T @ information[e] @ whole
        gradient += share * whole.T @ information[e] @ residuals[e]
    stays = np.repeat(free < 0, size)
    dense[stays], dense[:, stays], gradient[stays] = 0.0, 0.0, 0.0
    dense[stays, stays] = 1.0
    rows, columns, between_ends = links(nodes, tails, heads)
    blocks, found = np.zeros((len(rows), size, size)), np.zeros((nodes, size))
    ends = tails, heads, between_ends, free
    given_arrays = *ends, by_tail, by_head, information, residuals, weights
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
    turns, root = rng.normal(size=(2, count, size, size))
    weights = root @ np.swapaxes(root, 1, 2)
    dense = np.zeros((nodes, size, nodes, size))
    for e in range(count):
        dense[tails[e], :, tails[e]] += turns[e] @ weights[e] @ turns[e].T
        dense[heads[e], :, heads[e]] += weights[e]
        dense[tails[e], :, heads[e]] -= turns[e] @ weights[e]
        dense[heads[e], :, tails[e]] -= weights[e] @ turns[e].T
    rows, columns, blocks = weighted_blocks(nodes, tails, heads, turns, weights)
    assert np.allclose(blocks, dense[rows, :, columns])
    x = rng.normal(size=(nodes, 2, size))
    product = np.einsum("npi,nimj->mpj", x, dense)
    found = np.zeros(x.shape)
    add_product(x, rows, columns, blocks, found)
    assert np.allclose(found, product)


@pytest.mark.parametrize("planar", [True, False])
def test_squares_are_those_of_the_residuals(planar: bool) -> None:
    tail, head, measured, wanted = edges(planar, 0.7, 2)
    tails, heads = np.arange(10).reshape(2, -1)
    root = np.random.default_rng(1).normal(size=(5, wanted.shape[1], wanted.shape[1]))
    information = root @ np.swapaxes(root, 1, 2)
    poses = np.concatenate([tail, head])
    residuals, squares = edge_fits(planar, poses, tails, heads, measured, information)
    assert np.allclose(residuals, wanted, atol=1e-9)
    assert np.allclose(squares, np.einsum("ei,eij,ej->e", wanted, information, wanted))


@pytest.mark.parametrize("size", [2, 3])
def test_nearest_rotations_are_those_of_the_singular_values(size: int) -> None:
    """Also of matrices that mirror, and of those that are rotations already."""
    rng = np.random.default_rng(4)
    matrices = rng.normal(size=(500, size, size))
    left, _, right = np.linalg.svd(matrices)
    left[..., -1] *= np.linalg.det(left @ right)[:, None]
    nearest = nearest_rotations(matrices)
    assert np.allclose(nearest, left @ right, atol=1e-9)
    assert np.allclose(nearest_rotations(3.0 * nearest), nearest, atol=1e-12)
    whole = nearest_rotations(np.eye(size)[None])
    assert np.array_equal(whole[0], np.eye(size))


@settings(max_examples=20)
@given(st.integers(1, 6), st.sampled_from([1, 3]), st.integers(0, 1000))
def test_small_equations_are_solved_and_indefinite_ones_told(
    nodes: int, size: int, seed: int
) -> None:
    rng = np.random.default_rng(seed)
    pairs = [(k, k) for k in range(nodes)] + [(i, j) for j in range(nodes) for i in range(j)]
    rows, columns = np.array(pairs).T.copy()
    root = rng.normal(size=(nodes * size, nodes * size))
    dense = root @ root.T + np.eye(nodes * size)
    blocks = dense.reshape(nodes, size, nodes, size)[rows, :, columns].copy()
    right = rng.normal(size=(nodes * size, 2))
    solver = solver_of(nodes, rows, columns, blocks)
    assert np.allclose(solver.solve(right), np.linalg.solve(dense, right))
    assert np.allclose(solver.solve(right[:, 0]), np.linalg.solve(dense, right[:, 0]))
    blocks[0, 0, 0] = -1.0
    with pytest.raises(NotPositiveDefiniteError):
        solver_of(nodes, rows, columns, blocks)


@pytest.mark.parametrize("planar", [True, False])
@pytest.mark.parametrize("seed", [1, 2, 3])
def test_derivatives_of_a_twin_are_those_of_its_cost_as_poses_move(planar: bool, seed: int) -> None:
    tail, head, measured, wanted = edges(planar, 0.4, seed)
    poses, size = np.concatenate([tail, head]), wanted.shape[1]
    tails = np.arange(len(poses))
    information = np.tile(np.diag(np.arange(1.0, size + 1.0)), (len(poses), 1, 1))
    ends, measured = (tails, np.roll(tails, -1)), np.concatenate([measured, measured])
    system = System(planar, *ends, measured, information, tails - 1)
    twin = twin_of(system, fit_of(system, poses).residuals)
    x = twin_poses(planar, poses)
    pulled = product(twin, twin.blocks, x)
    gradient, hessian = derivatives(twin, x, pulled, multipliers(twin, x, pulled))
    way = np.random.default_rng(seed).normal(size=gradient.shape)
    there, here, back = (0.5 * twin_cost(twin, moved(x, t * way)) for t in (1e-3, 0.0, -1e-3))
    assert np.isclose((there - back) / 2e-3, np.vdot(gradient, way), rtol=1e-4)
    curved = np.einsum("bi,bij,bj->b", way[twin.rows], hessian, way[twin.columns])
    twice = np.where(twin.rows == twin.columns, 1.0, 2.0)
    assert np.isclose((there - 2.0 * here + back) / 1e-6, twice @ curved, rtol=1e-4)
