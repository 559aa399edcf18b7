"""Symmetric equations so small that one dense triangle is fastest: factorised and solved."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from mapmyworld.kernels.compiling import jit

Floats = NDArray[np.float64]
Index = NDArray[np.int64]


@jit
def factorise_small(rows: Index, columns: Index, blocks: Floats, upper: Floats) -> bool:
    """Sets U (N, N), upper triangle of `U' U`, a matrix of blocks (B, d, d) at nodes, from zeros.

    False where it is not positive definite.
    """
    size = blocks.shape[1]
    for b in range(len(rows)):
        first, second = rows[b] * size, columns[b] * size
        for i in range(size):
            for j in range(size):
                upper[min(first, second) + i, max(first, second) + j] = (
                    blocks[b, i, j] if first <= second else blocks[b, j, i]
                )
    for k in range(len(upper)):
        pivot = upper[k, k]
        if not 0.0 < pivot < math.inf:
            return False
        root = math.sqrt(pivot)
        for j in range(k, len(upper)):
            upper[k, j] /= root
        for i in range(k + 1, len(upper)):
            share = upper[k, i]
            if share != 0.0:  # most of them are
                for j in range(i, len(upper)):
                    upper[i, j] -= share * upper[k, j]
    return True


@jit
def solve_small(upper: Floats, x: Floats) -> None:
    """Solves `U' U X = X` in place for X (N, K)."""
    for c in range(x.shape[1]):
        for k in range(len(upper)):
            known = x[k, c] / upper[k, k]
            x[k, c] = known
            for j in range(k + 1, len(upper)):
                x[j, c] -= upper[k, j] * known
        for k in range(len(upper) - 1, -1, -1):
            left = x[k, c]
            for j in range(k + 1, len(upper)):
                left -= upper[k, j] * x[j, c]
            x[k, c] = left / upper[k, k]
