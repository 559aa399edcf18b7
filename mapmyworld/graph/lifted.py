"""A start from more dimensions: there the twin has few local minima or none.

Rotations become frames of d vectors in p > d dimensions, where wrong minima open up into saddles;
the minimum found there is projected back. Boumal, "A Riemannian low-rank method for optimization
over semidefinite matrices" (2015); Rosen et al., "SE-Sync" (2019), the Riemannian staircase.
"""

from __future__ import annotations

import numpy as np

from mapmyworld.geometry import Array
from mapmyworld.geometry.planar import matrix_to_planar, planar_to_matrix
from mapmyworld.geometry.rigid import invert
from mapmyworld.graph.newton import hessian_blocks, newton_step
from mapmyworld.graph.pose_graph import components
from mapmyworld.graph.starts import nearest_rotations
from mapmyworld.graph.system import Fit, System
from mapmyworld.graph.twin import (
    Twin,
    certificate_blocks,
    multipliers,
    product,
    slope,
    twin_cost,
    twin_of,
    twin_poses,
)

_EXTRA = 2  # dimensions more than the world has
_STEPS = 20  # at most: where it led to a better minimum it took 6 to 13
_PERTURBED = 0.1  # rad: how far rotations are turned out of the world at first
_GAIN = 1e-4  # share of the cost gained by a step, below which the minimum is near enough
_SEED = 0
# Share of the graph's cost that a twin has to have: over 0.97 wherever this start led to something
# better, under 0.5 where axes are known a hundred times better than others and correlated.
_TELLING = 0.5
_FLOOR = 1e-9  # share of the largest diagonal that every step is damped by
_LARGEST = 1e8  # share of the diagonal at which no step helps any more


def lifted_start(system: System, near: Fit) -> Array | None:
    """Poses near the minimum that the twin has in more dimensions; those given if none is found.

    None where the twin costs so much less than the graph that its minima are not the graph's.
    """
    poses, twin = near.poses, twin_of(system, near.residuals)
    size, p = twin.dimension, twin.dimension + _EXTRA
    level = twin_poses(system.planar, poses)
    if 0.5 * twin_cost(twin, level) < _TELLING * near.cost:
        return None
    x = _raised(level, p)
    lowered = _lowered(_descended(twin, x), twin)
    found = np.tile(np.eye(4), (len(x), 1, 1))
    found[:, :size, 3], found[:, :size, :size] = lowered[:, :, 0], lowered[:, :, 1:]
    full = planar_to_matrix(poses) if system.planar else poses
    found = _held(system, full, found)
    found[twin.points, :size, :size] = np.eye(size)
    return matrix_to_planar(found) if system.planar else found


def _held(system: System, poses: Array, found: Array) -> Array:
    """What was found, every connected part moved so that a node that must stay has stayed."""
    part = components(len(poses), system.tails, system.heads)
    fixed = np.flatnonzero(system.free < 0)
    first = fixed[np.unique(part[fixed], return_index=True)[1]]
    moves = np.tile(np.eye(4), (int(part.max()) + 1, 1, 1))
    moves[part[first]] = poses[first] @ invert(found[first])
    result = moves[part] @ found
    result[fixed] = poses[fixed]
    return np.asarray(result)


def _raised(x: Array, p: int) -> Array:
    count, size = x.shape[:2]
    spread = _PERTURBED * np.random.default_rng(_SEED).normal(size=(count, p - size, size))
    turned = np.concatenate([x[:, :, 1:], spread], axis=1)
    places = np.concatenate([x[:, :, :1], np.zeros((count, p - size, 1))], axis=1)
    return np.concatenate([places, _orthonormal(turned)], axis=2)


def _orthonormal(frames: Array) -> Array:
    """The nearest frames (N, p, d) of orthonormal columns."""
    left, _, right = np.linalg.svd(frames, full_matrices=False)
    return np.asarray(left @ right)


def _bases(x: Array) -> Array:
    """(N, m, p, d + 1): turns within a frame's own span, out of it, and translations."""
    count, p, size = x.shape[0], x.shape[1], x.shape[2] - 1
    frame = x[:, :, 1:]
    outside = np.linalg.qr(frame, mode="complete")[0][:, :, size:]
    pairs = [(i, j) for i in range(size) for j in range(i)]
    bases = np.zeros((count, len(pairs) + (p - size) * size + p, p, size + 1))
    for k, (i, j) in enumerate(pairs):
        bases[:, k, :, 1 + j], bases[:, k, :, 1 + i] = frame[:, :, i], -frame[:, :, j]
    for k in range((p - size) * size):
        bases[:, len(pairs) + k, :, 1 + k % size] = outside[:, :, k // size]
    bases[:, -p:, :, 0] = np.eye(p)
    return bases


def _descended(twin: Twin, x: Array) -> Array:
    """X near a minimum of the twin, by damped Newton steps."""
    cost, damping = twin_cost(twin, x), 1e-3
    for _ in range(_STEPS):
        pulled = product(twin, twin.blocks, x)
        multiplied = multipliers(twin, x, pulled)
        blocks, bases = certificate_blocks(twin, multiplied), _bases(x)
        flat = bases.reshape(*bases.shape[:2], -1)
        gradient = np.einsum("nka,na->nk", flat, slope(x, pulled, multiplied).reshape(len(x), -1))
        hessian = hessian_blocks(twin, blocks, bases)
        while True:
            step = newton_step(twin, gradient, hessian, damping, _FLOOR, _EXTRA)
            trial = x if step is None else _moved(x, bases, step)
            found = twin_cost(twin, trial)
            if step is not None and found <= cost:
                break
            damping *= 10.0
            if damping > _LARGEST:
                return x
        gain, x, cost, damping = cost - found, trial, found, max(1e-9, damping / 10.0)
        if gain <= _GAIN * cost:
            break
    return x


def _moved(x: Array, bases: Array, step: Array) -> Array:
    found = x + np.einsum("nk,nkxp->nxp", step, bases)
    found[:, :, 1:] = _orthonormal(found[:, :, 1:])
    return np.asarray(found)


def _lowered(x: Array, twin: Twin) -> Array:
    """X in the world's own dimensions: the directions that the frames span most."""
    size = twin.dimension
    frames = x[:, :, 1:]
    _, vectors = np.linalg.eigh(np.einsum("nij,nkj->ik", frames, frames))
    turn = vectors[:, -size:].T
    lowered = turn @ x
    if np.median(np.linalg.det(lowered[:, :, 1:])) < 0:
        lowered[:, -1] *= -1.0
    lowered[:, :, 1:] = nearest_rotations(lowered[:, :, 1:])
    return np.asarray(lowered)
