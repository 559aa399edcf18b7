"""How a sparse symmetric matrix whose blocks are nodes is eliminated, clique by clique.

Nodes are ordered by nested dissection and gathered into cliques (supernodes), which form a tree.
Davis, "Direct methods for sparse linear systems" (2006), chapters 4 to 7.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import lru_cache
from itertools import pairwise

import numpy as np

from mapmyworld.geometry import Array
from mapmyworld.graph.pose_graph import Index

# Nodes of a clique, and the share of zeros up to which it may be joined from smaller ones.
_RELAXED = ((4, 1.0), (16, 0.6), (40, 0.2), (10**9, 0.05))

# Patterns whose analysis is kept: the same edges are judged, proven and given covariances.
_REMEMBERED = 4


@dataclass(frozen=True, slots=True, eq=False)
class Clique:
    """Nodes eliminated together; numbers are places in the elimination order."""

    first: int
    last: int
    """Eliminated are `first` to `last - 1`."""
    rows: Index
    """Later nodes (R,) they are linked to, ascending."""
    parent: int
    """The clique that takes the Schur complement; -1 for roots."""
    into_parent: Index
    """(R * d,) scalars of the parent's front at which `rows` stand there."""
    blocks: slice
    """Blocks of the matrix, in the order of `Symbolic.block_order`, that enter here."""
    places: Index
    """(blocks * d * d,) where their scalars stand in the front, flat."""


@dataclass(frozen=True, slots=True, eq=False)
class Symbolic:
    """Everything about a factorisation that depends on the pattern alone."""

    size: int
    """Unknowns of a node."""
    order: Index
    """(N,) nodes in the order of elimination."""
    block_order: Index
    """(B,) the given blocks in the order in which cliques take them."""
    transposed: Index
    """(T,) which of these, in their new order, stand above the diagonal and are turned."""
    cliques: tuple[Clique, ...]
    bounds: Index
    """(C + 1,) where the nodes of each clique begin."""
    rows: Index
    begins: Index
    """(C + 1,) where those of each clique begin among the later nodes `rows` of all."""
    starts: Index
    """(C + 1,) where the numbers of each clique begin in the factor."""


def analyse(count: int, rows: Index, columns: Index, size: int) -> Symbolic:
    """The elimination of a symmetric matrix with blocks (size, size) at (rows, columns).

    Each unordered pair of nodes occurs at most once; every node has its diagonal block.
    """
    ends = rows.astype(np.int64).tobytes(), columns.astype(np.int64).tobytes()
    return _analysed(count, *ends, size)


@lru_cache(maxsize=_REMEMBERED)
def _analysed(count: int, row_bytes: bytes, column_bytes: bytes, size: int) -> Symbolic:
    return _symbolic(_tree_of(count, row_bytes, column_bytes), size)


def forget_patterns() -> None:
    """Lets go of the eliminations that are remembered."""
    _linked.cache_clear()
    _analysed.cache_clear()
    _tree_of.cache_clear()


def links(count: int, tails: Index, heads: Index) -> tuple[Index, Index, Index]:
    """Rows and columns of the blocks of edges between nodes, and the block (E,) of each edge.

    Every node's diagonal comes first, then each linked pair once, the lower node first.
    """
    return _linked(count, tails.astype(np.int64).tobytes(), heads.astype(np.int64).tobytes())


@lru_cache(maxsize=_REMEMBERED)
def _linked(count: int, tail_bytes: bytes, head_bytes: bytes) -> tuple[Index, Index, Index]:
    tails, heads = np.frombuffer(tail_bytes, np.int64), np.frombuffer(head_bytes, np.int64)
    keys = np.minimum(tails, heads) * count + np.maximum(tails, heads)
    order = keys.argsort(kind="stable")
    ascending, new = keys[order], np.ones(len(keys), np.bool_)
    new[1:] = ascending[1:] != ascending[:-1]
    linked, slot, nodes = ascending[new], np.empty(len(keys), np.int64), np.arange(count)
    slot[order] = new.cumsum() - 1
    rows, columns = np.concatenate([[nodes, nodes], np.divmod(linked, count)], axis=1)
    return rows, columns, count + slot


def summed(slots: Index, values: Array, count: int) -> Array:
    """(count, ...) sums of the values (E, ...) that belong to the same slot."""
    width = math.prod(values.shape[1:])
    places = (slots[:, None] * width + np.arange(width)).ravel()
    flat = np.bincount(places, values.ravel(), minlength=count * width)
    return np.asarray(flat, np.float64).reshape(count, *values.shape[1:])


def _dissected(count: int, rows: Index, columns: Index) -> Index:
    """Nodes in an order of little fill: nested dissection, by METIS as gtsam holds it."""
    import gtsam

    links = gtsam.SymbolicFactorGraph()
    off = rows != columns
    for a, b in zip(rows[off].tolist(), columns[off].tolist(), strict=True):
        links.push_factor(a, b)
    linked = np.unique(np.concatenate([rows[off], columns[off]]))
    alone = np.setdiff1d(np.arange(count), linked)
    if len(linked) == 0:
        return alone
    found = gtsam.Ordering.MetisSymbolicFactorGraph(links)
    order = [found.at(k) for k in range(found.size())]
    return np.concatenate([alone, np.array(order, np.int64)])


@dataclass(frozen=True, slots=True, eq=False)
class _Tree:
    """Columns gathered into cliques, and where blocks of any size belong."""

    order: Index
    """(N,) nodes in the order of elimination."""
    first: Index
    last: Index
    """(C,) columns of a clique."""
    rows: Index
    """Later nodes of all cliques, one clique after the other, ascending in each."""
    begins: Index
    """(C + 1,) where those of a clique begin."""
    parents: Index
    """(C,) -1 for roots."""
    into_parent: Index
    """Where `rows` stand in the parent's front; of roots, nothing."""
    block_order: Index
    transposed: Index
    tall: Index
    wide: Index
    """(B,) row and column of each ordered block in the front of its clique."""
    block_begins: Index
    """(C + 1,) the blocks of a clique."""


@lru_cache(maxsize=_REMEMBERED)
def _tree_of(count: int, row_bytes: bytes, column_bytes: bytes) -> _Tree:
    from mapmyworld.kernels.elimination import column_structures, gathered_columns

    rows, columns = np.frombuffer(row_bytes, np.int64), np.frombuffer(column_bytes, np.int64)
    place = np.empty(count, np.int64)
    place[_dissected(count, rows, columns)] = np.arange(count)
    begins, found = column_structures(*_later_links(count, place[rows], place[columns]))
    heights = np.diff(begins)
    parents = np.full(count, -1)
    parents[heights > 0] = found[begins[:-1][heights > 0]]
    widths, shares = (np.array(column) for column in zip(*_RELAXED, strict=True))
    order, last = gathered_columns(parents, heights, widths, shares)
    renumbered = np.empty(count, np.int64)
    renumbered[order] = np.arange(count)
    place = renumbered[place]
    tops = order[last - 1]
    later = renumbered[found[_runs(begins[tops], heights[tops])]]
    return _tree(place, last, later, heights[tops], place[rows], place[columns])


def _later_links(count: int, rows: Index, columns: Index) -> tuple[Index, Index]:
    """Where the later nodes begin to which each column is linked, and these nodes."""
    low, high = np.minimum(rows, columns), np.maximum(rows, columns)
    order = np.argsort(low, kind="stable")
    order = order[low[order] < high[order]]
    return np.searchsorted(low[order], np.arange(count + 1)), high[order]


def _runs(begins: Index, lengths: Index) -> Index:
    """Places `begins[k]`, `begins[k] + 1`, ... for every k, one run after the other."""
    before = np.cumsum(lengths) - lengths
    return np.repeat(begins - before, lengths) + np.arange(int(lengths.sum()))


def _tree(
    place: Index, last: Index, later: Index, heights: Index, at_row: Index, at_column: Index
) -> _Tree:
    count, cliques = len(place), np.arange(len(last))
    first = np.concatenate([[0], last[:-1]])
    owner, begins = np.repeat(cliques, last - first), np.concatenate([[0], np.cumsum(heights)])
    keys = np.sort(np.repeat(cliques, heights) * count + later)
    rows = keys % count

    def local(clique: Index, nodes: Index) -> Index:
        """Places of nodes in fronts: a clique's own nodes first, then the later ones."""
        behind = np.searchsorted(keys, clique * count + nodes) - begins[clique]
        own = nodes < last[clique]
        width = last[clique] - first[clique]
        return np.asarray(np.where(own, nodes - first[clique], width + behind))

    parents = np.full(len(last), -1)
    parents[heights > 0] = owner[rows[begins[:-1][heights > 0]]]
    into = local(np.repeat(parents, heights), rows)
    low, high = np.minimum(at_row, at_column), np.maximum(at_row, at_column)
    block_order = np.argsort(low * count + high, kind="stable")
    transposed = np.flatnonzero((at_row < at_column)[block_order])
    low, high = low[block_order], high[block_order]
    tall, wide = local(owner[low], high), low - first[owner[low]]
    ends = np.concatenate([[0], np.searchsorted(low, last)])
    order = np.argsort(place)
    return _Tree(
        order, first, last, rows, begins, parents, into, block_order, transposed, tall, wide, ends
    )


def _symbolic(tree: _Tree, size: int) -> Symbolic:
    inner = np.arange(size)
    into = (tree.into_parent[:, None] * size + inner).ravel()
    begins, ends = tree.begins, tree.block_begins
    fronts = (tree.last - tree.first + np.diff(begins)) * size
    height = np.repeat(fronts, np.diff(ends))[:, None, None]
    row, column = ((k * size)[:, None] + inner for k in (tree.tall, tree.wide))
    places = (column[:, None, :] * height + row[:, :, None]).reshape(-1)
    ranges = zip(
        tree.first.tolist(),
        tree.last.tolist(),
        tree.parents.tolist(),
        pairwise(begins.tolist()),
        pairwise(ends.tolist()),
        strict=True,
    )
    cliques = [
        Clique(
            first,
            last,
            tree.rows[a:b],
            parent,
            into[a * size : b * size],
            slice(start, end),
            places[start * size * size : end * size * size],
        )
        for first, last, parent, (a, b), (start, end) in ranges
    ]
    bounds = np.append(tree.first, len(tree.order))
    widths, heights = np.diff(bounds) * size, np.diff(begins) * size
    starts = np.concatenate([[0], np.cumsum(widths * (widths + heights))])
    orders = tree.order, tree.block_order, tree.transposed
    return Symbolic(size, *orders, tuple(cliques), bounds, tree.rows, begins, starts)
