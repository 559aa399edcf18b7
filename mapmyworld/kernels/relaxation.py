"""The relaxation of a pose graph to free matrices, added up edge by edge."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from mapmyworld.kernels.compiling import jit

Floats = NDArray[np.float64]
Index = NDArray[np.int64]


@jit
def add_relaxed(
    tails: Index,
    heads: Index,
    between: Index,
    motions: Floats,
    weights: Floats,
    tau: Floats,
    blocks: Floats,
) -> None:
    """Adds `|(Rj - Ri R) W^(1/2)|^2 + tau |tj - ti - Ri t|^2` of edges to blocks (B, d + 1, d + 1).

    Motions (E, 4, 4) hold R and t. An angle a about the axis n costs `2 (1 - cos a) (trace W - n' W
    n)`: with weights K (E, 1, 1) or (E, 3, 3), W is so that a rotation error by vector w costs at
    most `w' K w`. A block is of a translation and a
    rotation's rows; those of the nodes come first, `between` (E,) is that of both ends, the lower
    node's rows first.
    """
    size = blocks.shape[1] - 1
    turned, weight = np.empty((size, size)), np.empty((size, size))
    for e in range(len(tails)):
        tail, head, link = tails[e], heads[e], between[e]
        motion, known, half = motions[e], tau[e], 0.0
        for i in range(weights.shape[1]):
            half += 0.5 * weights[e, i, i]
        for i in range(size):
            for j in range(size):
                weight[i, j] = half if i == j else 0.0
                weight[i, j] -= weights[e, i, j] if size == 3 else 0.0
        blocks[tail, 0, 0] += known
        blocks[head, 0, 0] += known
        blocks[link, 0, 0] -= known
        for i in range(size):
            shift = known * motion[i, 3]
            blocks[tail, 0, 1 + i] += shift
            blocks[tail, 1 + i, 0] += shift
            if tail < head:
                blocks[link, 1 + i, 0] -= shift
            else:
                blocks[link, 0, 1 + i] -= shift
            for j in range(size):
                turned[i, j] = 0.0
                for k in range(size):
                    turned[i, j] += motion[i, k] * weight[k, j]
        for i in range(size):
            for j in range(size):
                blocks[head, 1 + i, 1 + j] += weight[i, j]
                total = known * motion[i, 3] * motion[j, 3]
                for k in range(size):
                    total += turned[i, k] * motion[j, k]
                blocks[tail, 1 + i, 1 + j] += total
                if tail < head:
                    blocks[link, 1 + i, 1 + j] -= turned[i, j]
                else:
                    blocks[link, 1 + j, 1 + i] -= turned[i, j]


@jit
def set_hessian(
    rows: Index, columns: Index, blocks: Floats, bases: Floats, hessian: Floats
) -> None:
    """Sets blocks (B, m, m) of a quadratic form along the tangents (N, m, p, q) of nodes.

    Its own blocks (B, q, q) stand at the same nodes.
    """
    left = np.empty(bases.shape[2:])
    for b in range(len(rows)):
        row, column = bases[rows[b]], bases[columns[b]]
        for k in range(bases.shape[1]):
            for i in range(bases.shape[2]):
                for j in range(bases.shape[3]):
                    left[i, j] = 0.0
                    for n in range(bases.shape[3]):
                        left[i, j] += row[k, i, n] * blocks[b, n, j]
            for m in range(bases.shape[1]):
                total = 0.0
                for i in range(bases.shape[2]):
                    for j in range(bases.shape[3]):
                        total += left[i, j] * column[m, i, j]
                hessian[b, k, m] = total
