"""A convex relaxation of a graph, whose global minimum can be proven: quadratic errors of matrices.

With poses as X = [t1 R1 t2 R2 ...] the relaxation's cost is `trace(X M X')`, where an edge adds
`|(Rj - Ri R) W^(1/2)|^2 + tau |tj - ti - Ri t|^2`. Weights are chosen so that half of it never
exceeds the graph's own cost: an angle's square is at least `2 (1 - cos)`, the logarithm of a motion
no shorter than its translation, and the information at least what W and tau make of it.
M, S and the bound are those of Rosen, Carlone, Bandeira, Leonard, "SE-Sync" (2019).
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from mapmyworld.backend.block_matrix import Blocks, colamd_order_of, edge_blocks, place_in
from mapmyworld.backend.connected_components import first_nodes
from mapmyworld.backend.landmarks import POINT, POLAR
from mapmyworld.backend.system import System, chosen_edges
from mapmyworld.geometry import Array, Index
from mapmyworld.geometry.planar import planar_to_matrix
from mapmyworld.geometry.rotations import skew, so3_exp


@dataclass(frozen=True, slots=True, eq=False)
class Relaxation:
    """The matrix M of a relaxation, block by block; a block is one node's translation and rotation.

    Nodes are numbered in the order of their elimination.
    """

    matrix: Blocks
    """Of blocks (d + 1, d + 1)."""
    order: Index
    """(N,) the system's nodes."""
    anchors: Index
    """(A,) one node of every connected component, where the map's frame is held."""
    points: Index
    """(L,) nodes without a rotation: landmarks."""


def relaxation_of(system: System, residuals: Array, *, equal: bool = False) -> Relaxation:
    """The convex relaxation of a system, closest where edges have these residuals (E, d).

    Bearings and ranges play no part in it. With `equal` an edge knows turns about all axes as badly
    as about its worst: further from the graph, but its minimum can be proven, which where
    axes differ mostly cannot.
    """
    count, points = len(system.free), np.flatnonzero(system.points)
    if system.kinds is not None:
        used = system.kinds != POLAR
        system, residuals = chosen_edges(system, used), residuals[used]
    tails, heads = system.tails, system.heads
    weights, tau = lower_weights(system.planar, system.information, residuals)
    if equal:
        weights = np.linalg.eigvalsh(weights)[:, :1, None] * np.eye(weights.shape[1])
    if system.kinds is not None:
        weights = np.where((system.kinds == POINT)[:, None, None], 0.0, weights)
    anchors = np.flatnonzero(first_nodes(count, tails, heads) == np.arange(count))
    order = colamd_order_of(count, tails, heads)
    place = place_in(order)
    matrix = _laid(replace(system, tails=place[tails], heads=place[heads]), weights, tau)
    return Relaxation(matrix, order, place[anchors], place[points])


def _laid(system: System, weights: Array, tau: Array) -> Blocks:
    """M, where `weights` (E, r, r) are K.

    An angle a about the axis n costs `2 (1 - cos a) (trace W - n' W n)`: W is chosen so that a
    rotation error by vector w costs at most `w' K w`.
    """
    size = 2 if system.planar else 3
    motions = planar_to_matrix(system.measured) if system.planar else system.measured
    turns, known = np.zeros((2, len(tau), size + 1, size + 1))
    turns[:, 0, 0], turns[:, 1:, 0] = 1.0, motions[:, :size, 3]
    turns[:, 1:, 1:] = motions[:, :size, :size]
    half = 0.5 * weights.trace(0, 1, 2)[:, None, None] * np.eye(size)
    known[:, 0, 0], known[:, 1:, 1:] = tau, half if system.planar else half - weights
    return edge_blocks(len(system.free), system.tails, system.heads, turns, known)


# Weights of rotation against translation that are tried: where the information couples them, what
# the one gains the other loses.
_RATIOS = (1.0, 0.5, 2.0, 0.25, 4.0)
_WHOLE = 1.0 - 1e-9  # share of a residual's worth that counts as all of it


def lower_weights(planar: bool, information: Array, residuals: Array) -> tuple[Array, Array]:
    """K (E, r, r) and tau (E,) with `v' I v >= w' K w + tau |u|^2` for every v of w and u.

    K is a share of the rotation's `information` I (E, m, m) and tau of the translation's smallest;
    of the pairs that are tried, the one that is worth most at these `residuals` (E, m).
    """
    turn, shift = (slice(2, 3), slice(0, 2)) if planar else (slice(0, 3), slice(3, 6))
    rotation = information[:, turn, turn]
    tau = _smallest(information[:, shift, shift])
    if not information[:, turn, shift].any():
        return rotation, tau
    spin, length = residuals[:, turn], np.sum(residuals[:, shift] ** 2, axis=1)
    by_turn = np.einsum("ei,eij,ej->e", spin, rotation, spin)
    slight = np.zeros_like(information)
    slight[:, shift, shift] = tau[:, None, None] * np.eye(slight[0, shift, shift].shape[0])
    slight[:, turn, turn] = rotation
    root = np.linalg.cholesky(slight)
    covariance = np.swapaxes(root, 1, 2) @ np.linalg.inv(information) @ root
    worth, kept = np.full(len(tau), -1.0), np.zeros((2, len(tau)))
    for ratio in _RATIOS:
        if (worth >= _WHOLE * (by_turn + tau * length)).all():
            break  # nothing couples them: no other pair is worth more
        scale = np.ones(information.shape[1])
        scale[turn] = np.sqrt(ratio)
        share = 1.0 / np.linalg.eigvalsh(scale[:, None] * covariance * scale)[:, -1]
        found = share * (ratio * by_turn + tau * length)
        kept = np.where(found > worth, np.stack([share * ratio, share]), kept)
        worth = np.maximum(found, worth)
    return kept[0][:, None, None] * rotation, kept[1] * tau


def _smallest(matrices: Array) -> Array:
    """The smallest eigenvalues (E,) of symmetric matrices (E, d, d), mostly diagonal ones."""
    diagonal = matrices.diagonal(0, 1, 2)
    if np.count_nonzero(matrices) == np.count_nonzero(diagonal):
        return np.asarray(np.minimum.reduce(diagonal, axis=1))
    return np.asarray(np.linalg.eigvalsh(matrices)[:, 0], np.float64)


def multiplied_out(blocks: Blocks, x: Array) -> Array:
    """(N, d, d + 1): X times a matrix, of poses X (N, d, d + 1)."""
    count, size = x.shape[:2]
    found = blocks.matrix @ np.swapaxes(x, 1, 2).reshape(-1, size)
    return np.swapaxes(found.reshape(count, size + 1, size), 1, 2)


def multipliers(relaxation: Relaxation, x: Array, pulled: Array) -> Array:
    """(N, d, d) symmetric Lagrange multipliers of the rotations' orthogonality at poses X.

    `x` is X and `pulled` is X M, (N, d, d + 1) both.
    """
    there = np.swapaxes(x[:, :, 1:], 1, 2) @ pulled[:, :, 1:]
    there = 0.5 * (there + np.swapaxes(there, 1, 2))
    there[relaxation.points] = 0.0
    return np.asarray(there)


def relaxation_poses(planar: bool, poses: Array) -> Array:
    """X (N, d, d + 1) of poses (N, 3 or 4, 4): translation, then rotation."""
    matrices, size = (planar_to_matrix(poses), 2) if planar else (poses, 3)
    return np.concatenate([matrices[:, :size, 3:4], matrices[:, :size, :size]], axis=2)


_SPINS = {2: np.array([[[0.0, -1.0], [1.0, 0.0]]]), 3: skew(np.eye(3))}


def tangent_bases(x: Array) -> Array:
    """(N, m, d, d + 1): how X (N, d, d + 1) changes with rotations of a node, then translations."""
    count, size = x.shape[:2]
    spins = _SPINS[size]
    bases = np.zeros((count, len(spins) + size, size, size + 1))
    bases[:, : len(spins), :, 1:] = x[:, None, :, 1:] @ spins
    bases[:, len(spins) :, :, 0] = np.eye(size)
    return bases


def moved(x: Array, step: Array) -> Array:
    """X (N, d, d + 1) after a `step` (N, m) along the tangents, in the same shape."""
    size = x.shape[1]
    spin = step.shape[1] - size
    found = np.empty(x.shape)
    found[:, :, 0] = x[:, :, 0] + step[:, spin:]
    found[:, :, 1:] = x[:, :, 1:] @ _turns(step[:, :spin])
    return found


def _turns(angles: Array) -> Array:
    """Rotations (N, d, d) by angles (N, 1) of the plane or rotation vectors (N, 3)."""
    if angles.shape[1] == 3:
        return so3_exp(angles)
    cos, sin = np.cos(angles[:, 0]), np.sin(angles[:, 0])
    return np.array([[cos, -sin], [sin, cos]]).transpose(2, 0, 1)
