"""Sparse symmetric systems whose blocks are nodes: assembled, factorised and solved."""

from __future__ import annotations

import numpy as np

from mapmyworld.geometry import Array
from mapmyworld.graph.block_solver import solver_of
from mapmyworld.graph.elimination import links
from mapmyworld.graph.pose_graph import Index

# Weight of the anchors against the largest weight of an edge: they stay where they are.
_ANCHOR = 1e3


def weighted_blocks(
    count: int, tails: Index, heads: Index, turns: Array, weights: Array
) -> tuple[Index, Index, Array]:
    """Rows, columns and blocks (B, d, d) of `|(X_head - X_tail T) W^(1/2)|^2`, summed over edges.

    X (p, d) are of nodes, T and W (E, d, d) of edges. Blocks stand as `links` puts them.
    """
    from mapmyworld.kernels.normal_equations import add_weighted

    rows, columns, between = links(count, tails, heads)
    blocks = np.zeros((len(rows), *weights.shape[1:]))
    plain = np.ascontiguousarray(turns), np.ascontiguousarray(weights)
    add_weighted(tails, heads, between, *plain, blocks)
    return rows, columns, blocks


def solve_weighted(
    tails: Index,
    heads: Index,
    turns: Array,
    weights: Array,
    anchors: Index,
    held: Array,
    right: Array,
) -> Array:
    """X' (N, d, K) that minimises that sum less `2 right X'`, for one weight (E,) of each edge.

    Anchors keep what is `held` of X', but for a share that edges are too weak to move.
    """
    count, inner = len(right), np.arange(turns.shape[1])
    alike = weights[:, None, None] * np.eye(len(inner))
    rows, columns, blocks = weighted_blocks(count, tails, heads, turns, alike)
    anchor = _ANCHOR * float(weights.max(initial=1.0))
    blocks[anchors[:, None], inner, inner] += anchor
    right[anchors] += anchor * held
    solver = solver_of(count, rows, columns, blocks)
    return solver.solve(right.reshape(count * len(inner), -1)).reshape(right.shape)
