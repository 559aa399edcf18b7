"""How a sparse symmetric matrix whose blocks are nodes is eliminated, clique by clique.

Nodes are ordered by nested dissection and gathered into cliques (supernodes), which form a tree.
Davis, "Direct methods for sparse linear systems" (2006), chapters 4 to 7.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from scipy.sparse import csr_array

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


def analyse(count: int, rows: Index, columns: Index, size: int) -> Symbolic:
    """The elimination of a symmetric matrix with blocks (size, size) at (rows, columns).

    Each unordered pair of nodes occurs at most once; every node has its diagonal block.
    """
    return _analysed(
        count, rows.astype(np.int64).tobytes(), columns.astype(np.int64).tobytes(), size
    )


@lru_cache(maxsize=_REMEMBERED)
def _analysed(count: int, row_bytes: bytes, column_bytes: bytes, size: int) -> Symbolic:
    rows, columns = np.frombuffer(row_bytes, np.int64), np.frombuffer(column_bytes, np.int64)
    place = np.empty(count, np.int64)
    place[_dissected(count, rows, columns)] = np.arange(count)
    below = _structures(count, place[rows], place[columns])
    groups, renumbered = _groups(below)
    return _with_blocks(groups, renumbered[place], rows, columns, size)


def links(count: int, tails: Index, heads: Index) -> tuple[Index, Index, Index]:
    """Rows and columns of the blocks of edges between nodes, and the block (E,) of each edge.

    Every node's diagonal comes first, then each linked pair once, the lower node first.
    """
    keys = np.minimum(tails, heads) * count + np.maximum(tails, heads)
    linked, slot = np.unique(keys, return_inverse=True)
    nodes = np.arange(count)
    rows, columns = (
        np.concatenate([nodes, linked // count]),
        np.concatenate([nodes, linked % count]),
    )
    return rows, columns, count + slot


def summed(slots: Index, values: Array, count: int) -> Array:
    """(count, ...) sums of the values (E, ...) that belong to the same slot."""
    order = np.arange(len(slots) + 1)
    gather = csr_array((np.ones(len(slots)), slots, order), shape=(len(slots), count))
    flat = gather.T @ values.reshape(len(values), int(np.prod(values.shape[1:])))
    return np.asarray(flat).reshape(count, *values.shape[1:])


def resized(symbolic: Symbolic, rows: Index, columns: Index, size: int) -> Symbolic:
    """The same elimination of the same pattern, for blocks of another size."""
    groups = [(c.first, c.last, c.rows) for c in symbolic.cliques]
    return _with_blocks(groups, np.argsort(symbolic.order), rows, columns, size)


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


def _structures(count: int, rows: Index, columns: Index) -> list[Index]:
    """Later nodes (ascending) that each node is linked to when its turn comes.

    Its own and those that its children in the elimination tree hand on.
    """
    low, high = np.minimum(rows, columns), np.maximum(rows, columns)
    order = np.lexsort((high, low))
    order = order[low[order] < high[order]]
    own = np.split(high[order], np.searchsorted(low[order], np.arange(1, count)))
    children: list[list[int]] = [[] for _ in range(count)]
    below: list[Index] = []
    for j in range(count):
        handed = own[j]
        if children[j]:
            handed = np.unique(np.concatenate([handed, *(below[c][1:] for c in children[j])]))
        below.append(handed)
        if len(handed):
            children[int(handed[0])].append(j)
    return below


def _groups(below: list[Index]) -> tuple[list[tuple[int, int, Index]], Index]:
    """Columns eliminated together, as first, last and later rows, and their new numbers.

    A column takes up those of its children in the elimination tree that cost few zeros; the
    columns of a group then get consecutive numbers, children before parents.
    """
    count = len(below)
    members: list[list[int]] = []
    entries: list[int] = []
    children: list[list[int]] = [[] for _ in range(count)]
    taken = np.zeros(count, np.bool_)
    for j in range(count):
        height = len(below[j])
        mine, stored = [j], height + 1
        for child in children[j]:
            width, both = len(mine) + len(members[child]), stored + entries[child]
            dense = width * (width + 1) // 2 + width * height
            if 1.0 - both / dense <= _zeros_allowed(width):
                mine, stored = members[child] + mine, both
                taken[child] = True
        members.append(mine)
        entries.append(stored)
        if height:
            children[int(below[j][0])].append(j)
    tops = np.flatnonzero(~taken).tolist()
    order = np.array([column for top in tops for column in members[top]], np.int64)
    renumbered = np.empty(count, np.int64)
    renumbered[order] = np.arange(count)
    last = np.cumsum([len(members[top]) for top in tops]).tolist()
    groups = [
        (end - len(members[top]), end, np.sort(renumbered[below[top]]))
        for top, end in zip(tops, last, strict=True)
    ]
    return groups, renumbered


def _zeros_allowed(width: int) -> float:
    """The share of zeros up to which columns go together: calls cost more than zeros."""
    return next(share for nodes, share in _RELAXED if width <= nodes)


def _with_blocks(
    groups: list[tuple[int, int, Index]], place: Index, rows: Index, columns: Index, size: int
) -> Symbolic:
    count = len(place)
    owner = np.zeros(count, np.int64)
    for number, (first, last, _) in enumerate(groups):
        owner[first:last] = number
    at_row, at_column = place[rows], place[columns]
    low, high = np.minimum(at_row, at_column), np.maximum(at_row, at_column)
    block_order = np.lexsort((high, low))
    transposed = np.flatnonzero((at_row < at_column)[block_order])
    low, high = low[block_order], high[block_order]
    ends = np.searchsorted(low, [last for _, last, _ in groups])
    inner, start = np.arange(size), 0
    cliques: list[Clique] = []
    for (first, last, later), end in zip(groups, ends.tolist(), strict=True):
        width, front = last - first, (last - first + len(later)) * size
        tall = _local(high[start:end], first, width, later)
        scalar_row = (tall * size)[:, None, None] + inner[:, None]
        scalar_column = ((low[start:end] - first) * size)[:, None, None] + inner
        parent, into = -1, np.zeros(0, np.int64)
        if len(later):
            parent = int(owner[later[0]])
            above, above_last, above_later = groups[parent]
            local = _local(later, above, above_last - above, above_later)
            into = ((local * size)[:, None] + inner).ravel()
        places = (scalar_column * front + scalar_row).ravel()
        cliques.append(Clique(first, last, later, parent, into, slice(start, end), places))
        start = end
    return Symbolic(size, np.argsort(place), block_order, transposed, tuple(cliques))


def _local(nodes: Index, first: int, width: int, later: Index) -> Index:
    """Places of nodes in a front: its own nodes first, then the later ones."""
    return np.where(nodes < first + width, nodes - first, width + np.searchsorted(later, nodes))
