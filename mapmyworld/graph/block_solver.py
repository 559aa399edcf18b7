"""Sparse symmetric equations whose blocks are nodes, by the factorisation that suits them.

As one dense matrix where it is tiny, else clique by clique.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np
from scipy.linalg.lapack import dpotrf, dpotrs

from mapmyworld.geometry import Array
from mapmyworld.graph.cholesky import NotPositiveDefiniteError, factorise
from mapmyworld.graph.elimination import analyse
from mapmyworld.graph.pose_graph import Index

_TINY = 150  # unknowns up to which one dense matrix is fastest


class Solver(Protocol):
    """A factorised matrix."""

    def solve(self, right: Array) -> Array:
        """The solution (N * d,) or (N * d, K) for the right-hand side."""
        ...


def solver_of(count: int, rows: Index, columns: Index, blocks: Array) -> Solver:
    """The equations of a symmetric matrix with blocks (B, d, d) at (rows, columns), ready to solve.

    Each unordered pair of nodes occurs at most once, each node's diagonal block first, in order.
    Raises `NotPositiveDefiniteError` where the matrix is not positive definite.
    """
    size = blocks.shape[1]
    if count * size <= _TINY:
        return _Dense.of(count, rows, columns, blocks)
    return factorise(analyse(count, rows, columns, size), blocks)


@dataclass(frozen=True, slots=True, eq=False)
class _Dense:
    """The lower Cholesky factor of the whole matrix."""

    triangle: Array

    @staticmethod
    def of(count: int, rows: Index, columns: Index, blocks: Array) -> _Dense:
        size = blocks.shape[1]
        upper = np.zeros((count, size, count, size))
        upper[rows, :, columns] = blocks
        lower = upper.reshape(count * size, count * size).T  # as LAPACK lays it out
        triangle, failed = dpotrf(lower, lower=1, clean=0, overwrite_a=1)
        if failed:
            raise NotPositiveDefiniteError("the edges leave a node undetermined")
        return _Dense(triangle)

    def solve(self, right: Array) -> Array:
        return np.asarray(dpotrs(self.triangle, right, lower=1)[0]).reshape(right.shape)
