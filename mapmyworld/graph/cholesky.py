"""Sparse Cholesky factors of matrices whose blocks are nodes, and what they are good for.

Multifrontal: nodes are ordered by nested dissection and gathered into cliques (supernodes); each
clique is a dense matrix, eliminated with LAPACK, that hands its Schur complement to its parent.
Davis, "Direct methods for sparse linear systems" (2006), chapters 4 to 7. Marginal covariances
follow by going back down the tree (Golub and Plemmons 1980; Kaess and Dellaert 2009).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.linalg.blas import dtrsm
from scipy.linalg.lapack import dpotrf

from mapmyworld.errors import GraphError
from mapmyworld.geometry import Array
from mapmyworld.graph.pose_graph import Index

LARGE = 9000
"""Unknowns from which this factorisation is faster than SuperLU's."""

# Nodes of a clique, and the share of zeros up to which it may be joined from smaller ones.
_RELAXED = ((4, 1.0), (16, 0.6), (40, 0.2), (10**9, 0.05))


class NotPositiveDefiniteError(GraphError):
    """A matrix that has no Cholesky factor: the graph leaves something undetermined."""


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
    place = np.empty(count, np.int64)
    place[_dissected(count, rows, columns)] = np.arange(count)
    below = _structures(count, place[rows], place[columns])
    groups, renumbered = _groups(below)
    return _with_blocks(groups, renumbered[place], rows, columns, size)


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


@dataclass(frozen=True, slots=True, eq=False)
class Factors:
    """The Cholesky factor, clique by clique."""

    symbolic: Symbolic
    triangles: tuple[Array, ...]
    """(p, p) lower factor of a clique's own unknowns."""
    below: tuple[Array, ...]
    """(r, p) rows of the factor below it."""

    def solve(self, right: Array) -> Array:
        """The solution (N * d, K) or (N * d,) of the factorised system."""
        symbolic = self.symbolic
        size, columns = symbolic.size, right.reshape(len(right), -1)
        x = columns.reshape(-1, size, columns.shape[1])[symbolic.order]
        for clique, triangle, below in zip(
            symbolic.cliques, self.triangles, self.below, strict=True
        ):
            own = x[clique.first : clique.last]
            part = dtrsm(1.0, triangle, own.reshape(-1, x.shape[2]), lower=1)
            own[:] = part.reshape(own.shape)
            if len(clique.rows):
                x[clique.rows] -= (below @ part).reshape(-1, size, x.shape[2])
        for clique, triangle, below in zip(
            reversed(symbolic.cliques),
            reversed(self.triangles),
            reversed(self.below),
            strict=True,
        ):
            own = x[clique.first : clique.last]
            part = own.reshape(-1, x.shape[2])
            if len(clique.rows):
                part = part - below.T @ x[clique.rows].reshape(-1, x.shape[2])
            own[:] = dtrsm(1.0, triangle, part, lower=1, trans_a=1).reshape(own.shape)
        result = np.empty_like(x)
        result[symbolic.order] = x
        return result.reshape(right.shape)

    def marginals(self) -> Array:
        """(N, d, d): the diagonal blocks of the inverse, by one pass down the tree."""
        symbolic, size = self.symbolic, self.symbolic.size
        found = np.empty((len(symbolic.order), size, size))
        waiting = np.bincount(
            [c.parent for c in symbolic.cliques if c.parent >= 0], minlength=len(symbolic.cliques)
        )
        fronts: dict[int, Array] = {}
        for number in range(len(symbolic.cliques) - 1, -1, -1):
            clique = symbolic.cliques[number]
            triangle, below = self.triangles[number], self.below[number]
            inverse = dtrsm(1.0, triangle, np.eye(len(triangle)), lower=1)
            own = inverse.T @ inverse
            front = own
            if clique.parent >= 0:
                later = fronts[clique.parent][np.ix_(clique.into_parent, clique.into_parent)]
                waiting[clique.parent] -= 1
                if waiting[clique.parent] == 0:
                    del fronts[clique.parent]
                across = -later @ (below @ inverse)
                own = own - (below @ inverse).T @ across
                front = np.block([[own, across.T], [across, later]])
            if waiting[number]:
                fronts[number] = front
            nodes = np.arange(clique.last - clique.first)
            tiles = own.reshape(len(nodes), size, len(nodes), size)
            found[symbolic.order[clique.first : clique.last]] = tiles[nodes, :, nodes, :]
        return found


def factorise(symbolic: Symbolic, blocks: Array) -> Factors:
    """The factors of the matrix with these blocks (B, d, d), as given to `analyse`.

    Raises `NotPositiveDefiniteError` when it is not positive definite.
    """
    size = symbolic.size
    ordered = blocks[symbolic.block_order]
    ordered[symbolic.transposed] = np.swapaxes(ordered[symbolic.transposed], 1, 2)
    updates: dict[int, list[tuple[Index, Array]]] = {}
    triangles: list[Array] = []
    below: list[Array] = []
    for number, clique in enumerate(symbolic.cliques):
        width = (clique.last - clique.first) * size
        front = width + len(clique.rows) * size
        flat = np.zeros(front * front)
        flat[clique.places] = ordered[clique.blocks].ravel()
        matrix = flat.reshape((front, front), order="F")
        for into, update in updates.pop(number, ()):
            matrix[into[:, None], into] += update
        triangle, failed = dpotrf(matrix[:width, :width], lower=1)
        if failed:
            raise NotPositiveDefiniteError(
                "the graph's information matrix is not positive definite"
            )
        triangles.append(triangle)
        rows = dtrsm(1.0, triangle, matrix[width:, :width], side=1, lower=1, trans_a=1)
        below.append(rows)
        if clique.parent >= 0:
            update = matrix[width:, width:] - rows @ rows.T
            updates.setdefault(clique.parent, []).append((clique.into_parent, update))
    return Factors(symbolic, tuple(triangles), tuple(below))
