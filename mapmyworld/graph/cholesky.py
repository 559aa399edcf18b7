"""Sparse Cholesky factors of matrices whose blocks are nodes, and what they are good for.

Multifrontal: each clique of the elimination is a dense matrix, factorised with LAPACK, that hands
its Schur complement to its parent. Covariances follow by going back down the tree (Golub and
Plemmons 1980; Kaess and Dellaert 2009).
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.linalg.blas import dsyrk, dtrsm
from scipy.linalg.lapack import dpotrf

from mapmyworld.errors import GraphError
from mapmyworld.geometry import Array
from mapmyworld.graph.elimination import Symbolic
from mapmyworld.graph.pose_graph import Index


class NotPositiveDefiniteError(GraphError):
    """A matrix that has no Cholesky factor: the graph leaves something undetermined."""


@dataclass(frozen=True, slots=True, eq=False)
class Factors:
    """The Cholesky factor, clique by clique."""

    symbolic: Symbolic
    values: Array
    """All numbers of the factor, clique by clique, column by column."""
    triangles: tuple[Array, ...]
    """(p, p) lower factor of a clique's own unknowns."""
    below: tuple[Array, ...]
    """(r, p) rows of the factor below it."""

    def solve(self, right: Array) -> Array:
        """The solution (N * d, K) or (N * d,) of the factorised system."""
        from mapmyworld.kernels.elimination import solve_in_place

        symbolic = self.symbolic
        size, result = symbolic.size, np.empty((len(right), right[:1].size))
        places = (symbolic.order[:, None] * size + np.arange(size)).ravel()
        layout = symbolic.bounds, symbolic.begins, symbolic.rows, symbolic.starts
        for k, column in enumerate(right.reshape(result.shape).T):
            x = np.asarray(column[places], np.float64)
            solve_in_place(size, *layout, self.values, x)
            result[places, k] = x
        return result.reshape(right.shape)

    def marginals(self) -> Array:
        """(N, d, d): the diagonal blocks of the inverse, by one pass down the tree."""
        symbolic, size = self.symbolic, self.symbolic.size
        found = np.empty((len(symbolic.order), size, size))
        for number, front in self.fronts():
            clique = symbolic.cliques[number]
            nodes = np.arange(clique.last - clique.first)
            own = front[: len(nodes) * size, : len(nodes) * size]
            tiles = own.reshape(len(nodes), size, len(nodes), size)
            found[symbolic.order[clique.first : clique.last]] = tiles[nodes, :, nodes, :]
        return found

    def fronts(self, asked: Index | None = None) -> Iterator[tuple[int, Array]]:
        """Numbers of cliques, parents first, and the inverse over all nodes of each front.

        All of them, or those `asked` for.
        """
        cliques = self.symbolic.cliques
        visited = self._ancestors(asked)
        parents = [c.parent for c, v in zip(cliques, visited, strict=True) if v and c.parent >= 0]
        waiting = np.bincount(parents, minlength=len(cliques))
        kept: dict[int, Array] = {}
        for number in np.flatnonzero(visited)[::-1].tolist():
            parent = cliques[number].parent
            above = None
            if parent >= 0:
                into = cliques[number].into_parent
                above = kept[parent][into[:, None], into]
                waiting[parent] -= 1
                if waiting[parent] == 0:
                    del kept[parent]
            front = _inverted(self.triangles[number], self.below[number], above)
            if waiting[number]:
                kept[number] = front
            yield number, front

    def _ancestors(self, asked: Index | None) -> NDArray[np.bool_]:
        """(C,) which cliques lie on the way from a root to those asked for."""
        cliques = self.symbolic.cliques
        visited = np.full(len(cliques), asked is None)
        if asked is not None:
            visited[asked] = True
            for number, clique in enumerate(cliques):
                if clique.parent >= 0 and visited[number]:
                    visited[clique.parent] = True
        return visited


def _inverted(triangle: Array, below: Array, above: Array | None) -> Array:
    """The inverse over a front: `above` is that over the rows which it shares with its parent."""
    inverse = dtrsm(1.0, triangle, np.eye(len(triangle)), lower=1)
    own = inverse.T @ inverse
    if above is None:
        return np.asarray(own)
    link = below @ inverse
    across = -above @ link
    width, height = len(own), len(above)
    front = np.empty((width + height, width + height))
    front[:width, :width] = own - link.T @ across
    front[width:, :width], front[:width, width:], front[width:, width:] = across, across.T, above
    return front


def factorise(symbolic: Symbolic, blocks: Array) -> Factors:
    """The factors of the matrix with these blocks (B, d, d), as given to `analyse`.

    Raises `NotPositiveDefiniteError` when it is not positive definite.
    """
    from mapmyworld.kernels.elimination import add_update

    size = symbolic.size
    ordered = blocks[symbolic.block_order]
    ordered[symbolic.transposed] = np.swapaxes(ordered[symbolic.transposed], 1, 2)
    updates: dict[int, list[tuple[Index, Array]]] = {}
    values = np.empty(symbolic.starts[-1])
    triangles: list[Array] = []
    below: list[Array] = []
    for number, (clique, start) in enumerate(
        zip(symbolic.cliques, symbolic.starts.tolist(), strict=False)
    ):
        width, height = (clique.last - clique.first) * size, len(clique.rows) * size
        front = width + height
        flat = np.zeros(front * front)
        flat[clique.places] = ordered[clique.blocks].ravel()
        matrix = flat.reshape((front, front), order="F")
        for update in updates.pop(number, ()):
            add_update(matrix, *update)
        middle, end = start + width * width, start + width * front
        triangle = values[start:middle].reshape((width, width), order="F")
        triangle[:] = matrix[:width, :width]
        if dpotrf(triangle, lower=1, overwrite_a=1)[1]:
            raise NotPositiveDefiniteError(
                "the graph's information matrix is not positive definite"
            )
        rows = values[middle:end].reshape((height, width), order="F")
        rows[:] = matrix[width:, :width]
        left = matrix[width:, width:].copy(order="F")
        del flat, matrix  # children wait for their parent without their fronts
        if height:
            dtrsm(1.0, triangle, rows, side=1, lower=1, trans_a=1, overwrite_b=1)
            dsyrk(-1.0, rows, beta=1.0, c=left, lower=1, overwrite_c=1)
        triangles.append(triangle)
        below.append(rows)
        if clique.parent >= 0:
            updates.setdefault(clique.parent, []).append((clique.into_parent, left))
    return Factors(symbolic, values, tuple(triangles), tuple(below))
