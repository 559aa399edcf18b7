"""A system's linear equations at a point: assembled block by block, factorised and solved.

Blocks stand over all nodes; a node that stays has the identity and no links, so that all who work
on the same edges eliminate the same pattern.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mapmyworld.geometry import Array
from mapmyworld.graph.block_solver import Solver, solver_of
from mapmyworld.graph.cholesky import Factors, factorise
from mapmyworld.graph.elimination import analyse, links
from mapmyworld.graph.pose_graph import Index
from mapmyworld.graph.system import System, jacobians_of, residuals_of


@dataclass(frozen=True, slots=True, eq=False)
class Pattern:
    """Where edges add to the symmetric matrix; depends on the edges alone."""

    rows: Index
    columns: Index
    """(B,) nodes of the blocks: every node's diagonal first."""
    slots: tuple[Index, Index, Index]
    """Scalars (E, d, d) of the blocks to which an edge adds: at its tail, at its head, between."""
    stays: NDArray[np.bool_]
    """(N,) nodes that do not move."""


def pattern_of(system: System) -> Pattern:
    """The pattern of the system's matrix."""
    rows, columns, block = links(len(system.free), system.tails, system.heads)
    slots = _slots(system, block, len(rows))
    return Pattern(rows, columns, slots, system.free < 0)


def _slots(system: System, block: Index, blocks: int) -> tuple[Index, Index, Index]:
    """What belongs to nodes that stay goes to a place behind the last block."""
    size, inner = system.dimension, np.arange(system.dimension)
    here = inner[:, None] * size + inner
    turned = (system.tails > system.heads)[:, None, None]
    within = np.where(turned, here.T, here)
    places = []
    for at, inside, ends in (
        (system.tails, here, (system.tails,)),
        (system.heads, here, (system.heads,)),
        (block, within, (system.tails, system.heads)),
    ):
        place = at[:, None, None] * size * size + inside
        stays = np.any([system.free[e] < 0 for e in ends], axis=0)
        places.append(np.where(stays[:, None, None], blocks * size * size, place).ravel())
    return places[0], places[1], places[2]


def linearise(
    system: System,
    pattern: Pattern,
    poses: Array,
    weights: Array | None = None,
    residuals: Array | None = None,
) -> tuple[Array, Array]:
    """Blocks (B, d, d) of the matrix and gradient (N, d) of half the cost at `poses`.

    `weights` (E,) scale information; `residuals` (E, d) are those at `poses`, where known.
    """
    residuals = residuals_of(system, poses) if residuals is None else residuals
    by_tail, by_head, left, right = _weighted(system, poses, residuals, weights)
    values = [left @ by_tail, right @ by_head, left @ by_head]
    size, count = system.dimension, len(pattern.rows)
    flat = np.bincount(
        np.concatenate(pattern.slots),
        np.concatenate([v.ravel() for v in values]),
        minlength=count * size * size + 1,
    )
    blocks = np.asarray(flat[:-1], np.float64).reshape(count, size, size)
    blocks[np.flatnonzero(pattern.stays)] = np.eye(size)
    return blocks, _gradient(system, pattern, left, right, residuals)


def gradient_of(system: System, pattern: Pattern, poses: Array, residuals: Array) -> Array:
    """(N, d) of half the cost at `poses`, where edges have these residuals (E, d)."""
    _, _, left, right = _weighted(system, poses, residuals)
    return _gradient(system, pattern, left, right, residuals)


def _weighted(
    system: System, poses: Array, residuals: Array, weights: Array | None = None
) -> tuple[Array, ...]:
    """Derivatives of the residuals by tail and head, and these transposed times information."""
    jacobians = jacobians_of(system, poses, residuals)
    information = system.information
    if weights is not None:
        information = information * weights[:, None, None]
    left, right = (np.swapaxes(j, 1, 2) @ information for j in jacobians)
    return *jacobians, left, right


def _gradient(
    system: System, pattern: Pattern, left: Array, right: Array, residuals: Array
) -> Array:
    gradient = np.zeros((len(system.free), system.dimension))
    for ends, jacobian in ((system.tails, left), (system.heads, right)):
        part = (jacobian @ residuals[..., None])[..., 0]
        for column in range(system.dimension):
            gradient[:, column] += np.bincount(ends, part[:, column], minlength=len(gradient))
    gradient[pattern.stays] = 0.0
    return gradient


def damped(pattern: Pattern, blocks: Array, damping: float) -> Array:
    """The blocks with so much of the diagonal on top of it."""
    raised, inner = blocks.copy(), np.arange(blocks.shape[1])
    raised[: len(pattern.stays), inner, inner] *= 1.0 + damping
    return raised


def factorised(pattern: Pattern, blocks: Array) -> Solver:
    """These equations, ready to be solved for any right-hand side (N * d,).

    Raises `NotPositiveDefiniteError` when the edges leave nodes undetermined.
    """
    return solver_of(len(pattern.stays), pattern.rows, pattern.columns, blocks)


def information_factors(system: System, poses: Array) -> Factors:
    """The Cholesky factors of the information at `poses`, over all nodes.

    Those that stay count as known to one unit. Raises `NotPositiveDefiniteError` where the edges
    leave a node undetermined.
    """
    pattern = pattern_of(system)
    symbolic = analyse(len(pattern.stays), pattern.rows, pattern.columns, system.dimension)
    return factorise(symbolic, linearise(system, pattern, poses)[0])
