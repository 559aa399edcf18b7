"""The least-squares problem of a pose graph as arrays, and its linear system at a point."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csc_array
from scipy.sparse.linalg import splu

from mapmyworld.errors import GraphError
from mapmyworld.geometry import Array
from mapmyworld.graph import cholesky
from mapmyworld.graph.cholesky import LARGE, Symbolic, analyse
from mapmyworld.graph.landmarks import sighting_jacobians, sighting_residuals
from mapmyworld.graph.pose_graph import Index
from mapmyworld.graph.residuals import edge_jacobians, edge_residuals, squared_sigmas

# Links between nodes, per node, from which it is: chains with few loops fill in hardly at all.
_DENSE = 1.25


@dataclass(frozen=True, slots=True, eq=False)
class System:
    """Edges between positions, and where each free node stands in the vector of unknowns."""

    planar: bool
    tails: Index
    heads: Index
    """(E,) positions of nodes."""
    measured: Array
    information: Array
    """(E, 3 or 4, 4) and (E, d, d)."""
    free: Index
    """(N,) number of each node among the free ones; -1 for those that stay."""
    kinds: Index | None = None
    """(E,) POINT or POLAR for sightings of landmarks, 0 for edges; None = all edges."""

    @property
    def dimension(self) -> int:
        """Unknowns of a node."""
        return 3 if self.planar else 6

    @property
    def size(self) -> int:
        """Unknowns in all."""
        return self.dimension * int(self.free.max(initial=-1) + 1)


@dataclass(frozen=True, slots=True, eq=False)
class Pattern:
    """Where blocks go in the sparse symmetric matrix; depends on the edges alone."""

    sources: tuple[NDArray[np.bool_], ...]
    """Which edges give a block (tail, tail), (head, head), (tail, head), (head, tail)."""
    slots: Index
    """Place of every scalar of these blocks among the stored entries."""
    indices: NDArray[np.int32]
    indptr: NDArray[np.int32]
    size: int
    symbolic: Symbolic | None
    """How to factorise it clique by clique, where that is the faster way."""


def number_free(node_count: int, fixed: Index) -> Index:
    """(N,) 0, 1, ... over the nodes that are not fixed, and -1 for those that are."""
    is_free = np.ones(node_count, np.bool_)
    is_free[fixed] = False
    return np.where(is_free, np.cumsum(is_free) - 1, -1).astype(np.int64)


def pattern_of(system: System) -> Pattern:
    """The pattern of the system's matrix."""
    a, b = system.free[system.tails], system.free[system.heads]
    both = (a >= 0) & (b >= 0)
    sources = (a >= 0, b >= 0, both, both)
    rows = np.concatenate([a[sources[0]], b[sources[1]], a[both], b[both]])
    columns = np.concatenate([a[sources[0]], b[sources[1]], b[both], a[both]])
    size, inner = system.dimension, np.arange(system.dimension)
    count = system.size // size
    keys, block = np.unique(columns * count + rows, return_inverse=True)
    block_columns, first = keys // count, np.searchsorted(keys, np.arange(count + 1) * count)
    height = np.diff(first)[block_columns]
    rank = np.arange(len(keys)) - first[block_columns]
    # Scalars stand column by column: all blocks of a block column, one scalar column at a time.
    corner = first[block_columns] * size * size + rank * size
    places = corner[:, None, None] + inner[:, None] + (height * size)[:, None, None] * inner
    indices = np.empty(places.size, np.int32)
    indices[places.ravel()] = np.broadcast_to(
        ((keys % count) * size)[:, None, None] + inner[:, None], places.shape
    ).ravel()
    tall = np.diff(first) * size
    indptr = np.concatenate([[0], np.cumsum(np.repeat(tall, size))])
    slots = places[block].ravel()
    symbolic = None
    low, high = np.minimum(a, b)[both], np.maximum(a, b)[both]
    linked = np.unique(low * count + high)
    if system.size >= LARGE and len(linked) > _DENSE * count:
        nodes = np.arange(count)
        symbolic = analyse(
            count,
            np.concatenate([nodes, linked // count]),
            np.concatenate([nodes, linked % count]),
            size,
        )
    return Pattern(
        sources,
        slots.astype(np.int64),
        indices,
        indptr.astype(np.int32),
        system.size,
        symbolic,
    )


def linearise(
    system: System, pattern: Pattern, poses: Array, weights: Array | None = None
) -> tuple[csc_array, Array]:
    """Matrix and gradient (size,) of the cost at `poses`; `weights` (E,) scale information."""
    residuals = residuals_of(system, poses)
    by_tail, by_head = jacobians_of(system, poses, residuals)
    information = system.information
    if weights is not None:
        information = information * weights[:, None, None]
    left, right = (np.swapaxes(j, 1, 2) @ information for j in (by_tail, by_head))
    blocks = (left @ by_tail, right @ by_head, left @ by_head, right @ by_tail)
    values = np.concatenate(
        [block[used].ravel() for block, used in zip(blocks, pattern.sources, strict=True)]
    )
    data = np.bincount(pattern.slots, values, minlength=len(pattern.indices))
    matrix = csc_array((data, pattern.indices, pattern.indptr), shape=(pattern.size, pattern.size))
    return matrix, _gradient(system, left, right, residuals)


def _gradient(system: System, left: Array, right: Array, residuals: Array) -> Array:
    size, count = system.dimension, system.size // system.dimension
    gradient = np.zeros((count + 1, size))
    for ends, jacobian in ((system.tails, left), (system.heads, right)):
        part = (jacobian @ residuals[..., None])[..., 0]
        target = np.where(system.free[ends] < 0, count, system.free[ends])
        for column in range(size):
            gradient[:, column] += np.bincount(target, part[:, column], minlength=count + 1)
    return gradient[:-1].ravel()


def residuals_of(system: System, poses: Array) -> Array:
    """(E, d) residuals of edges and sightings."""
    tails, heads = poses[system.tails], poses[system.heads]
    residuals = edge_residuals(system.planar, tails, heads, system.measured)
    if system.kinds is not None:
        k = np.flatnonzero(system.kinds)
        residuals[k] = sighting_residuals(
            system.planar, tails[k], heads[k], system.measured[k], system.kinds[k]
        )
    return residuals


def jacobians_of(system: System, poses: Array, residuals: Array) -> tuple[Array, Array]:
    """Derivatives (E, d, d) of these residuals by tangents of tails and heads."""
    tails, heads = poses[system.tails], poses[system.heads]
    by_tail, by_head = edge_jacobians(system.planar, tails, heads, residuals)
    if system.kinds is not None:
        k = np.flatnonzero(system.kinds)
        found = sighting_jacobians(system.planar, tails[k], heads[k], system.kinds[k])
        by_tail[k], by_head[k] = found
    return by_tail, by_head


def chosen_edges(system: System, which: NDArray[np.bool_] | Index) -> System:
    """The system with some of its edges."""
    return replace(
        system,
        tails=system.tails[which],
        heads=system.heads[which],
        measured=system.measured[which],
        information=system.information[which],
        kinds=None if system.kinds is None else system.kinds[which],
    )


def edge_chi2(system: System, poses: Array) -> Array:
    """(E,) squared sigmas of every edge at `poses`."""
    return squared_sigmas(residuals_of(system, poses), system.information)


def factorise(matrix: csc_array, pattern: Pattern) -> Any:
    """Something that can `solve`: small systems by SuperLU, large ones clique by clique.

    Raises `GraphError` when the edges leave nodes undetermined.
    """
    if pattern.symbolic is None:
        try:
            return splu(
                matrix,
                permc_spec="MMD_AT_PLUS_A",
                diag_pivot_thresh=0.0,
                options={"SymmetricMode": True},
            )
        except RuntimeError:
            raise GraphError("the edges leave some nodes undetermined") from None
    size = pattern.symbolic.size
    tiles = matrix.tobsr((size, size))
    tiles.sort_indices()
    count = pattern.size // size
    rows = np.repeat(np.arange(count), np.diff(tiles.indptr))
    diagonal, upper = rows == tiles.indices, rows < tiles.indices
    blocks = np.concatenate([tiles.data[diagonal], tiles.data[upper]])
    return cholesky.factorise(pattern.symbolic, blocks)


def step_to_nodes(system: System, step: Array) -> Array:
    """Tangents (N, d) of all nodes from the vector of unknowns; zero for those that stay."""
    tangents = np.vstack([step.reshape(-1, system.dimension), np.zeros(system.dimension)])
    return tangents[system.free]


def predicted_covariances(factors: Any, system: System, poses: Array) -> tuple[Array, Array]:
    """Covariances (E, d, d) of the edges' residuals as the factorised solution predicts them,
    and these residuals.
    """
    residuals = residuals_of(system, poses)
    jacobians = jacobians_of(system, poses, residuals)
    size, count = system.dimension, len(system.tails)
    ends = (system.free[system.tails], system.free[system.heads])
    found = np.zeros((count, size, size))
    together = _together(system)
    for first in range(0, count, together):
        batch = range(first, min(first + together, count))
        right = np.zeros((system.size, size * len(batch)))
        for n, k in enumerate(batch):
            for numbers, blocks in zip(ends, jacobians, strict=True):
                if numbers[k] >= 0:
                    place = slice(numbers[k] * size, (numbers[k] + 1) * size)
                    right[place, n * size : (n + 1) * size] += blocks[k].T
        solved = factors.solve(right)
        for n, k in enumerate(batch):
            columns = slice(n * size, (n + 1) * size)
            found[k] = right[:, columns].T @ solved[:, columns]
    return found, residuals


def joint_covariances(
    factors: Any, system: System, poses: Array, groups: Sequence[Index]
) -> Iterator[tuple[Array, Array]]:
    """Residuals (C, d) of every group of edges, and their covariance (C d, C d) together, as the
    solution predicts them.
    """
    waiting: list[Index] = []
    for k, group in enumerate(groups):
        waiting.append(group)
        if k == len(groups) - 1 or sum(map(len, waiting)) >= _together(system):
            yield from _solved_together(factors, system, poses, waiting)
            waiting = []


def _solved_together(
    factors: Any, system: System, poses: Array, groups: Sequence[Index]
) -> Iterator[tuple[Array, Array]]:
    asked = chosen_edges(system, np.concatenate(groups))
    residuals = residuals_of(asked, poses)
    size, count = system.dimension, len(residuals)
    right = np.zeros((count, size, system.size))
    ends = (system.free[asked.tails], system.free[asked.heads])
    inner = np.arange(size)
    for numbers, blocks in zip(ends, jacobians_of(asked, poses, residuals), strict=True):
        k = np.flatnonzero(numbers >= 0)
        columns = (numbers[k] * size)[:, None, None] + inner
        right[k[:, None, None], inner[:, None], columns] += blocks[k]
    flat = right.reshape(count * size, -1)
    solved = factors.solve(flat.T)  # Fortran order, as SuperLU wants it
    end = 0
    for group in groups:
        first, end = end, end + len(group)
        rows = slice(first * size, end * size)
        yield residuals[first:end], np.asarray(flat[rows] @ solved[:, rows])


_BATCH = 50  # edges whose predictions are solved for at once, at most
_BATCH_NUMBERS = 3_000_000  # on the right-hand sides of a batch, of 8 bytes, which bounds memory


def _together(system: System) -> int:
    """Edges whose predictions are solved for at once."""
    return max(1, min(_BATCH, _BATCH_NUMBERS // max(system.size * system.dimension, 1)))
