"""Sparse symmetric matrices whose blocks are nodes, summed over edges.

Nodes are numbered in the order of their elimination, so that nothing is sorted again: COLAMD's,
which the start, the descent and the proof of one graph share.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import gtsam
import numpy as np
from scipy.sparse import bsr_array, csc_array

from mapmyworld.backend.information import Factorised
from mapmyworld.geometry import Array, Index


@dataclass(frozen=True, slots=True, eq=False)
class Blocks:
    """A symmetric matrix of blocks (d, d); those of the diagonal are all there."""

    matrix: bsr_array
    own: Index
    """(N,) where the diagonal's stand among its blocks."""

    @staticmethod
    def summed(count: int, rows: Index, columns: Index, blocks: Array) -> Blocks:
        """The matrix of blocks (B, d, d) at `rows`, `columns` (B,); those at one place added up."""
        size, every = blocks.shape[1], np.arange(count)
        key = np.concatenate([rows * count + columns, every * (count + 1)])
        blocks = np.concatenate([blocks, np.zeros((count, size, size))])
        order = np.argsort(key, kind="stable")
        key = key[order]
        first = np.flatnonzero(np.diff(key, prepend=-1))
        summed, key = np.add.reduceat(blocks[order], first, axis=0), key[first]
        starts = np.searchsorted(key, np.arange(count + 1) * count).astype(np.int32)
        laid = summed, (key % count).astype(np.int32), starts
        matrix = bsr_array(laid, shape=(count * size, count * size))
        return Blocks(matrix, np.searchsorted(key, every * (count + 1)))

    def with_blocks(self, blocks: Array) -> Blocks:
        """A matrix of other blocks (B, k, k) at the same places."""
        count, size = len(self.own), blocks.shape[1]
        laid = blocks, self.matrix.indices, self.matrix.indptr
        return Blocks(bsr_array(laid, shape=(count * size, count * size)), self.own)

    def plus(self, own: Array) -> Blocks:
        """The matrix with more (N, d, d) on its diagonal."""
        blocks = self.matrix.data.copy()
        blocks[self.own] += own
        return self.with_blocks(blocks)

    def factorised(self, order: Index) -> Factorised:
        """Its factors, where `order` (N,) names the node of each row of blocks."""
        size = self.matrix.blocksize[0]
        rows = self.matrix.tocsr()  # and columns, as it is symmetric
        columns = csc_array((rows.data, rows.indices, rows.indptr), shape=rows.shape)
        return Factorised.of(columns, (order[:, None] * size + np.arange(size)).ravel())


def edge_blocks(count: int, tails: Index, heads: Index, turns: Array, weights: Array) -> Blocks:
    """The matrix of `|(X_head - X_tail T) W^(1/2)|^2`, summed over edges.

    They lead from `tails` to `heads`, (E,) both; T and W are `turns` and `weights`, (E, d, d) both.
    """
    across = turns @ weights
    at_tail = across @ np.swapaxes(turns, 1, 2)
    rows = np.concatenate([heads, tails, tails, heads])
    columns = np.concatenate([heads, tails, heads, tails])
    blocks = np.concatenate([weights, at_tail, -across, -np.swapaxes(across, 1, 2)])
    return Blocks.summed(count, rows, columns, blocks)


def diagonals(numbers: Array) -> Array:
    """Diagonal blocks (N, d, d) of numbers (N, d)."""
    return np.asarray(numbers[:, :, None] * np.eye(numbers.shape[1]))


def colamd_order_of(count: int, tails: Index, heads: Index) -> Index:
    """All nodes (N,) in the order in which COLAMD eliminates them; those without an edge first.

    Edges join `tails` and `heads` (E,).
    """
    return _ordered(count, tails.astype(np.int64).tobytes(), heads.astype(np.int64).tobytes())


def place_in(order: Index) -> Index:
    """(N,) where each node stands in an `order` (N,)."""
    place = np.empty_like(order)
    place[order] = np.arange(len(order))
    return place


@lru_cache(maxsize=1)
def _ordered(count: int, from_nodes: bytes, to_nodes: bytes) -> Index:
    """COLAMD's order, kept of the last graph: its start, descent and proof ask one by one."""
    tails, heads = np.frombuffer(from_nodes, np.int64), np.frombuffer(to_nodes, np.int64)
    links = gtsam.SymbolicFactorGraph()
    apart = tails != heads
    for tail, head in zip(tails[apart].tolist(), heads[apart].tolist(), strict=True):
        links.push_factor(tail, head)
    linked = np.zeros(0, np.int64)
    if links.size():
        order = gtsam.Ordering.ColamdSymbolicFactorGraph(links)
        linked = np.array([order.at(k) for k in range(order.size())], np.int64)
    alone = np.ones(count, np.bool_)
    alone[linked] = False
    found = np.concatenate([np.flatnonzero(alone), linked])
    found.flags.writeable = False  # shared
    return found
