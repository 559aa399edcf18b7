"""Sparse symmetric systems whose blocks are nodes: assembled, factorised and solved."""

from __future__ import annotations

import numpy as np

from mapmyworld.geometry import Array
from mapmyworld.graph.block_solver import solver_of
from mapmyworld.graph.elimination import links, summed
from mapmyworld.graph.pose_graph import Index


def solve_blocks(
    count: int,
    tails: Index,
    heads: Index,
    diagonal_blocks: Array,
    cross_blocks: Array,
    anchors: Index,
    anchor_block: Array,
    right: Array,
) -> Array:
    """The solution (count * d, K) of a symmetric system made of edges' blocks (E, d, d).

    An edge adds `diagonal_blocks` at its tail and at its head, and `cross_blocks` at (tail, head),
    transposed at (head, tail); `anchor_block` is added at every anchor.
    """
    turned = np.where((tails > heads)[:, None, None], np.swapaxes(cross_blocks, 1, 2), cross_blocks)
    rows, columns, slot = links(count, tails, heads)
    blocks = summed(slot, turned, len(rows))
    blocks[:count] += summed(tails, diagonal_blocks, count) + summed(heads, diagonal_blocks, count)
    np.add.at(blocks, anchors, anchor_block)
    return solver_of(count, rows, columns, blocks).solve(right)
