"""Sparse symmetric systems whose blocks are nodes: assembled, factorised and solved."""

from __future__ import annotations

import numpy as np
from scipy.sparse import coo_array
from scipy.sparse.linalg import splu

from mapmyworld.geometry import Array
from mapmyworld.graph.cholesky import LARGE, NotPositiveDefiniteError, factorise
from mapmyworld.graph.elimination import analyse, links, summed
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
    size = anchor_block.shape[0]
    turned = np.where((tails > heads)[:, None, None], np.swapaxes(cross_blocks, 1, 2), cross_blocks)
    rows, columns, slot = links(count, tails, heads)
    blocks = summed(slot, turned, len(rows))
    blocks[:count] += summed(tails, diagonal_blocks, count) + summed(heads, diagonal_blocks, count)
    np.add.at(blocks, anchors, anchor_block)
    if count * size >= LARGE:
        return factorise(analyse(count, rows, columns, size), blocks).solve(right)
    return _by_superlu(count, size, rows, columns, blocks, right)


def _by_superlu(
    count: int, size: int, rows: Index, columns: Index, blocks: Array, right: Array
) -> Array:
    off = rows != columns
    every = np.concatenate([blocks, np.swapaxes(blocks[off], 1, 2)])
    row, column = np.concatenate([rows, columns[off]]), np.concatenate([columns, rows[off]])
    inner = np.arange(size)
    at_row = np.broadcast_to((row * size)[:, None, None] + inner[:, None], every.shape)
    at_column = np.broadcast_to((column * size)[:, None, None] + inner, every.shape)
    shape = (count * size, count * size)
    matrix = coo_array((every.ravel(), (at_row.ravel(), at_column.ravel())), shape=shape)
    try:
        factors = splu(
            matrix.tocsc(),
            permc_spec="MMD_AT_PLUS_A",
            diag_pivot_thresh=0.0,
            options={"SymmetricMode": True},
        )
    except RuntimeError:  # "Factor is exactly singular"
        raise NotPositiveDefiniteError("the edges leave a node undetermined") from None
    return np.asarray(factors.solve(right))
