"""Edges' linear equations, added up block by block."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from mapmyworld.kernels.compiling import jit

Floats = NDArray[np.float64]
Index = NDArray[np.int64]


@jit
def add_edges(
    tails: Index,
    heads: Index,
    between: Index,
    free: Index,
    by_tail: Floats,
    by_head: Floats,
    information: Floats,
    residuals: Floats,
    weights: Floats,
    blocks: Floats,
    gradient: Floats,
) -> None:
    """Adds the normal equations of edges to blocks (B, d, d) and gradient (N, d).

    A node whose number in `free` (N,) is negative stays: it has the identity, no links and no
    gradient. The derivatives (E, d, d) of residuals (E, d) belong to the nodes `tails` and
    `heads`, whose diagonal blocks come first; `between` (E,) is the block of both, the lower
    node's rows first. `weights` are of all edges where there are any. Without blocks only the
    gradient is added up.
    """
    size = gradient.shape[1]
    for n in range(len(free) if len(blocks) else 0):
        for i in range(size):
            blocks[n, i, i] += 1.0 if free[n] < 0 else 0.0
    left, pull = np.empty((2, size, size)), np.empty(size)
    for e in range(len(tails)):
        share = weights[e] if len(weights) else 1.0
        tail, head = tails[e], heads[e]
        tail_moves, head_moves = 1.0 * (free[tail] >= 0), 1.0 * (free[head] >= 0)
        for i in range(size):
            pull[i] = 0.0
            for k in range(size):
                pull[i] += share * information[e, i, k] * residuals[e, k]
        for i in range(size):
            for k in range(size):
                gradient[tail, i] += tail_moves * by_tail[e, k, i] * pull[k]
                gradient[head, i] += head_moves * by_head[e, k, i] * pull[k]
        if len(blocks) == 0:
            continue
        for i in range(size):
            for j in range(size):
                left[0, i, j] = left[1, i, j] = 0.0
            for k in range(size):
                a = share * tail_moves * by_tail[e, k, i]
                b = share * head_moves * by_head[e, k, i]
                for j in range(size):
                    left[0, i, j] += a * information[e, k, j]
                    left[1, i, j] += b * information[e, k, j]
        for i in range(size):
            for k in range(size):
                a, b = left[0, i, k], left[1, i, k]
                for j in range(size):
                    blocks[tail, i, j] += a * by_tail[e, k, j]
                    blocks[head, i, j] += b * by_head[e, k, j]
                    if tail < head:
                        blocks[between[e], i, j] += a * head_moves * by_head[e, k, j]
                    else:
                        blocks[between[e], i, j] += b * tail_moves * by_tail[e, k, j]


@jit
def add_weighted(
    tails: Index, heads: Index, between: Index, turns: Floats, weights: Floats, blocks: Floats
) -> None:
    """Adds `|(X_head - X_tail T) W^(1/2)|^2` of edges, T and W (E, d, d), to blocks (B, d, d).

    They are laid out the same way.
    """
    size = blocks.shape[1]
    left = np.empty((size, size))
    for e in range(len(tails)):
        tail, head = tails[e], heads[e]
        for i in range(size):
            for j in range(size):
                left[i, j] = 0.0
                for k in range(size):
                    left[i, j] += turns[e, i, k] * weights[e, k, j]
        for i in range(size):
            for j in range(size):
                row, column = (i, j) if tail < head else (j, i)
                blocks[between[e], row, column] -= left[i, j]
                blocks[head, i, j] += weights[e, i, j]
                for k in range(size):
                    blocks[tail, i, j] += left[i, k] * turns[e, j, k]


@jit
def add_product(x: Floats, rows: Index, columns: Index, blocks: Floats, found: Floats) -> None:
    """Adds X (N, p, d) times a symmetric matrix of blocks (B, d, d), one of each pair."""
    for b in range(len(rows)):
        row, column = rows[b], columns[b]
        for i in range(x.shape[1]):
            for j in range(x.shape[2]):
                for k in range(x.shape[2]):
                    found[column, i, j] += x[row, i, k] * blocks[b, k, j]
                    if row != column:
                        found[row, i, j] += x[column, i, k] * blocks[b, j, k]
