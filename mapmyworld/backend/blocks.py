"""Sparse symmetric matrices whose blocks are nodes, summed over edges."""

from __future__ import annotations

import gtsam
import numpy as np
from scipy.sparse import bsr_array, sparray

from mapmyworld.backend.information import Factorised
from mapmyworld.backend.parts import Index
from mapmyworld.geometry import Array


def edge_blocks(count: int, tails: Index, heads: Index, turns: Array, weights: Array) -> bsr_array:
    """The matrix of `|(X_head - X_tail T) W^(1/2)|^2`, summed over edges; T and W are (E, d, d)."""
    across = turns @ weights
    at_tail = across @ np.swapaxes(turns, 1, 2)
    rows = np.concatenate([heads, tails, tails, heads])
    columns = np.concatenate([heads, tails, heads, tails])
    blocks = np.concatenate([weights, at_tail, -across, -np.swapaxes(across, 1, 2)])
    return summed_blocks(count, rows, columns, blocks)


def summed_blocks(count: int, rows: Index, columns: Index, blocks: Array) -> bsr_array:
    """The sparse matrix of blocks (B, d, d), those at the same place added up."""
    size = blocks.shape[1]
    order = np.argsort(rows * count + columns, kind="stable")
    key = (rows * count + columns)[order]
    first = np.flatnonzero(np.diff(key, prepend=-1))
    summed = np.add.reduceat(blocks[order], first, axis=0) if len(key) else blocks
    starts = np.searchsorted(key[first] // count, np.arange(count + 1))
    laid = summed, key[first] % count, starts
    return bsr_array(laid, shape=(count * size, count * size))


def factorised(matrix: sparray, order: Index) -> Factorised:
    """The factors of a matrix of blocks, its nodes eliminated in this order."""
    size = matrix.shape[0] // len(order)
    return Factorised.of(matrix, (order[:, None] * size + np.arange(size)).ravel())


def metis_order_of(count: int, tails: Index, heads: Index) -> Index:
    """All nodes (N,) in the order in which METIS eliminates them; those without an edge first."""
    links = gtsam.SymbolicFactorGraph()
    apart = tails != heads
    for tail, head in zip(tails[apart].tolist(), heads[apart].tolist(), strict=True):
        links.push_factor(tail, head)
    linked = np.zeros(0, np.int64)
    if links.size():
        order = gtsam.Ordering.MetisSymbolicFactorGraph(links)
        linked = np.array([order.at(k) for k in range(order.size())], np.int64)
    alone = np.ones(count, np.bool_)
    alone[linked] = False
    return np.concatenate([np.flatnonzero(alone), linked])
