"""Sparse symmetric systems whose blocks are nodes: assembling and factorising."""

from __future__ import annotations

from typing import Any

import numpy as np
from scipy.sparse import coo_array, csc_array
from scipy.sparse.linalg import splu

from mapmyworld.geometry import Array
from mapmyworld.graph.pose_graph import Index


def assemble(
    count: int,
    tails: Index,
    heads: Index,
    tail_blocks: Array,
    head_blocks: Array,
    cross_blocks: Array,
    anchors: Index,
    anchor_block: Array,
) -> csc_array:
    """The symmetric matrix (count * d, count * d) of edges' blocks (E, d, d).

    `cross_blocks` stand at (tail, head), their transposes at (head, tail); `anchor_block` is
    added on the diagonal of every anchor.
    """
    size = anchor_block.shape[0]
    rows = np.concatenate([tails, heads, tails, heads, anchors])
    columns = np.concatenate([tails, heads, heads, tails, anchors])
    blocks = np.concatenate(
        [
            tail_blocks,
            head_blocks,
            cross_blocks,
            np.swapaxes(cross_blocks, 1, 2),
            np.broadcast_to(anchor_block, (len(anchors), size, size)),
        ]
    )
    inner = np.arange(size)
    row = (rows[:, None, None] * size + inner[:, None]) + np.zeros(size, np.int64)
    column = (columns[:, None, None] * size + inner) + np.zeros((size, 1), np.int64)
    shape = (count * size, count * size)
    return coo_array((blocks.ravel(), (row.ravel(), column.ravel())), shape=shape).tocsc()


def factorise(matrix: csc_array) -> Any:
    """The factors of a symmetric matrix, without pivoting, so that its signs show in U."""
    return splu(
        matrix,
        permc_spec="MMD_AT_PLUS_A",
        diag_pivot_thresh=0.0,
        options={"SymmetricMode": True},
    )
