"""Sparse symmetric systems whose blocks are nodes: assembled, factorised and solved."""

from __future__ import annotations

import numpy as np

from mapmyworld.geometry import Array
from mapmyworld.graph.block_solver import solver_of
from mapmyworld.graph.elimination import links
from mapmyworld.graph.pose_graph import Index


def edge_blocks(
    count: int, tails: Index, heads: Index, at_tail: Array, at_head: Array, across: Array
) -> tuple[Index, Index, Array]:
    """Rows, columns and blocks (B, d, d) of a symmetric matrix that edges (E) add up to.

    An edge adds its blocks (E, d, d) at its tail, at its head, and `across` at (tail, head),
    transposed at (head, tail). Blocks stand as `links` puts them.
    """
    from mapmyworld.kernels.normal_equations import add_blocks

    rows, columns, between = links(count, tails, heads)
    blocks = np.zeros((len(rows), *across.shape[1:]))
    add_blocks(tails, heads, between, at_tail, at_head, across, blocks)
    return rows, columns, blocks


def solve_blocks(
    count: int,
    tails: Index,
    heads: Index,
    weights: Array,
    across: Array,
    anchors: Index,
    anchor_weight: float,
    right: Array,
) -> Array:
    """The solution (count, d, K) of a symmetric system made of edges' blocks (E, d, d).

    An edge adds its weight (E,) to the diagonal at its tail and at its head, and `across` between
    them as in `edge_blocks`; `anchor_weight` is added at every anchor.
    """
    size = across.shape[1]
    own = weights[:, None, None] * np.eye(size)
    rows, columns, blocks = edge_blocks(count, tails, heads, own, own, across)
    blocks[anchors] += anchor_weight * np.eye(size)
    solution = solver_of(count, rows, columns, blocks).solve(right.reshape(count * size, -1))
    return solution.reshape(right.shape)
