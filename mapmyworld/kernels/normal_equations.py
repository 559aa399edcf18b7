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
    by_tail: Floats,
    by_head: Floats,
    information: Floats,
    residuals: Floats,
    weights: Floats,
    blocks: Floats,
    gradient: Floats,
) -> None:
    """Adds the normal equations of edges to blocks (B, d, d) and gradient (N, d).

    The derivatives (E, d, d) of residuals (E, d) belong to the nodes `tails` and `heads`, whose
    diagonal blocks come first; `between` (E,) is the block of both, the lower node's rows first.
    `weights` are of all edges where there are any. Without blocks only the gradient is added up.
    """
    size = gradient.shape[1]
    left, pull = np.empty((2, size, size)), np.empty(size)
    for e in range(len(tails)):
        share = weights[e] if len(weights) else 1.0
        tail, head = tails[e], heads[e]
        for i in range(size):
            pull[i] = 0.0
            for k in range(size):
                pull[i] += share * information[e, i, k] * residuals[e, k]
        for i in range(size):
            for k in range(size):
                gradient[tail, i] += by_tail[e, k, i] * pull[k]
                gradient[head, i] += by_head[e, k, i] * pull[k]
        if len(blocks) == 0:
            continue
        for i in range(size):
            for j in range(size):
                left[0, i, j] = left[1, i, j] = 0.0
            for k in range(size):
                a, b = share * by_tail[e, k, i], share * by_head[e, k, i]
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
                        blocks[between[e], i, j] += a * by_head[e, k, j]
                    else:
                        blocks[between[e], i, j] += b * by_tail[e, k, j]


@jit
def add_blocks(
    tails: Index,
    heads: Index,
    between: Index,
    at_tail: Floats,
    at_head: Floats,
    across: Floats,
    blocks: Floats,
) -> None:
    """Adds what edges have at both ends and across (E, d, d) to blocks laid out the same way."""
    size = blocks.shape[1]
    for e in range(len(tails)):
        tail, head = tails[e], heads[e]
        for i in range(size):
            for j in range(size):
                blocks[tail, i, j] += at_tail[e, i, j]
                blocks[head, i, j] += at_head[e, i, j]
                if tail < head:
                    blocks[between[e], i, j] += across[e, i, j]
                else:
                    blocks[between[e], j, i] += across[e, i, j]


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
