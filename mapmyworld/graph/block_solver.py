"""Sparse symmetric equations whose blocks are nodes, by the factorisation that suits them.

As one dense matrix where it is tiny; SuperLU for small graphs and for chains with few loops, which
fill in hardly at all; clique by clique for what is large and has many links.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from typing import Protocol

import numpy as np
from numpy.typing import NDArray
from scipy.linalg.lapack import dpotrf, dpotrs
from scipy.sparse import csc_array
from scipy.sparse.linalg import SuperLU, splu

from mapmyworld.geometry import Array
from mapmyworld.graph import elimination
from mapmyworld.graph.cholesky import NotPositiveDefiniteError, factorise
from mapmyworld.graph.pose_graph import Index

_TINY = 150  # unknowns up to which one dense matrix is fastest
_LARGE = 9000  # unknowns from which cliques are faster
_DENSE = 1.25  # links between nodes, per node, from which they are
_REMEMBERED = 2  # layouts that are kept: a graph's, with blocks of two sizes


def forget_patterns() -> None:
    """Lets go of what was worked out about the patterns of the last graphs."""
    _layout_of.cache_clear()
    elimination.forget_patterns()


class Solver(Protocol):
    """A factorised matrix."""

    def solve(self, right: Array) -> Array:
        """The solution (N * d,) or (N * d, K) for the right-hand side."""
        ...


def solver_of(
    count: int, rows: Index, columns: Index, blocks: Array, positive: bool = False
) -> Solver:
    """The equations of a symmetric matrix with blocks (B, d, d) at (rows, columns), ready to solve.

    Each unordered pair of nodes occurs at most once, each node's diagonal block first, in order.
    Raises `NotPositiveDefiniteError` where the matrix is singular, or not positive definite if that
    is asked for.
    """
    size = blocks.shape[1]
    if count * size <= _TINY:
        return _Dense.of(count, rows, columns, blocks)
    if count * size >= _LARGE and len(rows) - count > _DENSE * count:
        return factorise(elimination.analyse(count, rows, columns, size), blocks)
    layout = _layout_of(count, rows.tobytes(), columns.tobytes(), size)
    factors = _superlu(layout, blocks)
    if positive and not _is_positive(factors):
        raise NotPositiveDefiniteError("the matrix is not positive definite")
    solver: Solver = factors
    return solver


@dataclass(frozen=True, slots=True, eq=False)
class _Dense:
    """The lower Cholesky factor of the whole matrix."""

    triangle: Array

    @staticmethod
    def of(count: int, rows: Index, columns: Index, blocks: Array) -> _Dense:
        size = blocks.shape[1]
        matrix = np.zeros((count, size, count, size))
        matrix[columns, :, rows] = np.swapaxes(blocks, 1, 2)
        matrix[rows, :, columns] = blocks
        triangle, failed = dpotrf(matrix.reshape(count * size, count * size), lower=1)
        if failed:
            raise NotPositiveDefiniteError("the edges leave a node undetermined")
        return _Dense(triangle)

    def solve(self, right: Array) -> Array:
        return np.asarray(dpotrs(self.triangle, right, lower=1)[0]).reshape(right.shape)


@dataclass(frozen=True, slots=True, eq=False)
class _Layout:
    """Where the entries of a compressed matrix stand in the blocks."""

    entries: Index
    indices: NDArray[np.int32]
    indptr: NDArray[np.int32]


@lru_cache(maxsize=_REMEMBERED)
def _layout_of(count: int, row_bytes: bytes, column_bytes: bytes, size: int) -> _Layout:
    """Columns of nodes hold the same rows; each column of blocks becomes `size` columns of them."""
    rows, columns = np.frombuffer(row_bytes, np.int64), np.frombuffer(column_bytes, np.int64)
    off = np.flatnonzero(rows != columns)
    source = np.concatenate([np.arange(len(rows)), off])
    row, column = np.concatenate([rows, columns[off]]), np.concatenate([columns, rows[off]])
    order = np.argsort(column * count + row)
    source, row, column = source[order], row[order], column[order]
    turned = (order >= len(rows))[:, None, None]
    heights = np.bincount(column, minlength=count)
    begins = np.cumsum(heights) - heights
    inner = np.arange(size)
    down, across = inner[None, None, :], inner[None, :, None]
    within = np.where(turned, across * size + down, down * size + across)
    first, height = begins[column], heights[column]
    corner = first * size * size + (np.arange(len(row)) - first) * size
    targets = corner[:, None, None] + across * (height * size)[:, None, None] + down
    entries, indices = np.empty((2, targets.size), np.int64)
    entries[targets] = source[:, None, None] * size * size + within
    indices[targets] = row[:, None, None] * size + down
    lengths = np.repeat(heights * size, size)
    indptr = np.concatenate([[0], np.cumsum(lengths)])
    return _Layout(entries, indices.astype(np.int32), indptr.astype(np.int32))


def _superlu(layout: _Layout, blocks: Array) -> SuperLU:
    size = len(layout.indptr) - 1
    values = blocks.ravel()[layout.entries]
    matrix = csc_array((values, layout.indices, layout.indptr), shape=(size, size))
    try:
        return splu(
            matrix,
            permc_spec="MMD_AT_PLUS_A",
            diag_pivot_thresh=0.0,
            panel_size=1,  # columns of such small fronts gain nothing by the panel
            options={"SymmetricMode": True},
        )
    except RuntimeError:  # "Factor is exactly singular"
        raise NotPositiveDefiniteError("the edges leave a node undetermined") from None


def _is_positive(factors: SuperLU) -> bool:
    """Whether all pivots are positive: taken from the diagonal, they have the matrix's signs."""
    diagonal = np.array_equal(factors.perm_r, factors.perm_c)
    return diagonal and bool((factors.U.diagonal() > 0.0).all())
