"""A system's linear equations at a point: assembled block by block, factorised and solved.

Blocks stand over all nodes; a node that stays has the identity and no links, so that all who work
on the same edges eliminate the same pattern.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csc_array
from scipy.sparse.linalg import SuperLU, splu

from mapmyworld.geometry import Array
from mapmyworld.graph.cholesky import LARGE, Factors, NotPositiveDefiniteError, factorise
from mapmyworld.graph.elimination import Symbolic, analyse, links
from mapmyworld.graph.pose_graph import Index
from mapmyworld.graph.system import System, jacobians_of, residuals_of

# Links between nodes, per node, from which it is: chains with few loops fill in hardly at all.
_DENSE = 1.25


class Solver(Protocol):
    """A factorised matrix."""

    def solve(self, right: Array) -> Array: ...


@dataclass(frozen=True, slots=True, eq=False)
class _OfFree:
    """SuperLU's factors over the scalars of the free nodes."""

    factors: SuperLU
    free: Index

    def solve(self, right: Array) -> Array:
        result = np.zeros(len(right))
        result[self.free] = self.factors.solve(right[self.free])
        return result


@dataclass(frozen=True, slots=True, eq=False)
class Sparse:
    """Where the entries of a compressed matrix over the free nodes stand in the blocks."""

    entries: Index
    indices: NDArray[np.int32]
    indptr: NDArray[np.int32]
    free: Index
    """(size,) their scalars among those of all nodes."""


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
    sparse: Sparse | None
    """How SuperLU takes it; None where it is factorised clique by clique."""


def pattern_of(system: System) -> Pattern:
    """The pattern of the system's matrix."""
    count, size = len(system.free), system.dimension
    rows, columns, block = links(count, system.tails, system.heads)
    slots = _slots(system, block, len(rows))
    pattern = Pattern(rows, columns, slots, system.free < 0, None)
    dense = len(rows) - count > _DENSE * count
    if dense and (system.size >= LARGE or not system.planar):
        return pattern
    sparse = _sparse(system, rows, columns)
    return Pattern(rows, columns, slots, pattern.stays, sparse) if size else pattern


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


def _sparse(system: System, rows: Index, columns: Index) -> Sparse:
    size, free, inner = system.dimension, system.free, np.arange(system.dimension)
    used = np.flatnonzero((free[rows] >= 0) & (free[columns] >= 0))
    off = used[rows[used] != columns[used]]
    here = inner[:, None] * size + inner
    row = [free[rows[used]], free[columns[off]]]
    column = [free[columns[used]], free[rows[off]]]
    entries = [
        used[:, None, None] * size * size + here,
        off[:, None, None] * size * size + here.T,
    ]
    shape = (-1, size, size)
    at_row = np.concatenate(row)[:, None, None] * size + inner[:, None]
    at_column = np.concatenate(column)[:, None, None] * size + inner
    at_row, at_column = (
        np.broadcast_to(a, (len(a), size, size)).ravel() for a in (at_row, at_column)
    )
    order = np.argsort(at_column * system.size + at_row, kind="stable")
    indptr = np.searchsorted(at_column[order], np.arange(system.size + 1))
    moves = np.flatnonzero(free >= 0)
    return Sparse(
        np.concatenate(entries).reshape(shape).ravel()[order],
        at_row[order].astype(np.int32),
        indptr.astype(np.int32),
        (moves[:, None] * size + inner).ravel(),
    )


def linearise(
    system: System, pattern: Pattern, poses: Array, weights: Array | None = None
) -> tuple[Array, Array]:
    """Blocks (B, d, d) of the matrix and gradient (N, d) of the cost at `poses`.

    `weights` (E,) scale information.
    """
    residuals, by_tail, by_head, left, right = _weighted(system, poses, weights)
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


def gradient_of(system: System, pattern: Pattern, poses: Array) -> Array:
    """(N, d) of half the cost at `poses`."""
    residuals, _, _, left, right = _weighted(system, poses)
    return _gradient(system, pattern, left, right, residuals)


def _weighted(system: System, poses: Array, weights: Array | None = None) -> tuple[Array, ...]:
    """Residuals, their derivatives by tail and head, and these transposed times information."""
    residuals = residuals_of(system, poses)
    jacobians = jacobians_of(system, poses, residuals)
    information = system.information
    if weights is not None:
        information = information * weights[:, None, None]
    left, right = (np.swapaxes(j, 1, 2) @ information for j in jacobians)
    return residuals, *jacobians, left, right


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
    sparse = pattern.sparse
    if sparse is None:
        return factors_of(pattern, blocks)
    size = len(sparse.free)
    values = blocks.ravel()[sparse.entries]
    matrix = csc_array((values, sparse.indices, sparse.indptr), shape=(size, size))
    try:
        factors = splu(
            matrix,
            permc_spec="MMD_AT_PLUS_A",
            diag_pivot_thresh=0.0,
            options={"SymmetricMode": True},
        )
    except RuntimeError:
        raise NotPositiveDefiniteError("the edges leave some nodes undetermined") from None
    return _OfFree(factors, sparse.free)


def symbolic_of(pattern: Pattern, size: int) -> Symbolic:
    """The elimination of the pattern with blocks of this size."""
    return analyse(len(pattern.stays), pattern.rows, pattern.columns, size)


def factors_of(pattern: Pattern, blocks: Array) -> Factors:
    """The Cholesky factors of these blocks; those that stay count as known to one unit.

    Raises `NotPositiveDefiniteError` where the edges leave a node undetermined.
    """
    return factorise(symbolic_of(pattern, blocks.shape[1]), blocks)


def information_factors(system: System, poses: Array) -> Factors:
    """The Cholesky factors of the information at `poses`, over all nodes."""
    pattern = pattern_of(system)
    return factors_of(pattern, linearise(system, pattern, poses)[0])
