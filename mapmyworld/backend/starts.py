"""Starts for the optimiser: along odometry, and by the linear relaxation of rotations."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.sparse import csr_array
from scipy.sparse.csgraph import breadth_first_order, minimum_spanning_tree

from mapmyworld.backend.block_matrix import colamd_order_of, diagonals, edge_blocks, place_in
from mapmyworld.backend.system import System
from mapmyworld.geometry import Array, Index
from mapmyworld.geometry.planar import (
    compose_planar,
    invert_planar,
    matrix_to_planar,
    planar_to_matrix,
)
from mapmyworld.geometry.rigid import invert


@dataclass(frozen=True, slots=True, eq=False)
class Tree:
    """A spanning tree of every component, rooted at its first node."""

    parents: Index
    """(N,) of every node; roots are their own."""
    motions: Array
    """(N, 3 or 4, 4) parent_from_node; identity for roots."""
    edges: Index
    """(N,) the edge that leads to the parent; -1 for roots."""


def spanning_tree(system: System, count: int, penalty: Index | None = None) -> Tree:
    """The tree of the shortest jumps over `count` nodes, each lengthened by its `penalty` (E,)."""
    planar, tails, heads, measured = system.planar, system.tails, system.heads, system.measured
    low, high = np.minimum(tails, heads), np.maximum(tails, heads)
    jump = high - low + (0 if penalty is None else penalty)
    order = np.lexsort((jump, high, low))
    keys, first = np.unique((low * count + high)[order], return_index=True)
    kept = order[first]
    weights = csr_array((jump[kept] + 1.0, (low[kept], high[kept])), shape=(count, count))
    parents = _parents(minimum_spanning_tree(weights))
    children = np.flatnonzero(parents != np.arange(count))
    above = parents[children]
    key = np.minimum(above, children) * count + np.maximum(above, children)
    edges = np.full(count, -1, np.int64)
    edges[children] = edge = kept[np.searchsorted(keys, key)]
    inverse = invert_planar if planar else invert
    forward = tails[edge] == above
    motions = np.zeros((count, 3)) if planar else np.tile(np.eye(4), (count, 1, 1))
    motions[children[forward]] = measured[edge[forward]]
    motions[children[~forward]] = inverse(measured[edge[~forward]])
    return Tree(parents, motions, edges)


def _parents(tree: csr_array) -> Index:
    """(N,) parent of every node; the first of every component is its own."""
    count = tree.shape[0]
    parents = np.full(count, -1, np.int64)
    for root in range(count):
        if parents[root] < 0:
            order, above = breadth_first_order(tree, root, directed=False)
            parents[order] = above[order]
            parents[root] = root
    return parents


def along_tree(planar: bool, guess: Array, parents: Index, motions: Array) -> Array:
    """Poses (N, 3 or 4, 4) of all nodes along a tree.

    By doubling: each round joins every node's path to its ancestor's. `parents` (N,) and `motions`
    (N, 3 or 4, 4) are a `Tree`'s; of `guess` (N, 3 or 4, 4), map_from_node, the poses of roots are
    kept.
    """
    compose = compose_planar if planar else np.matmul
    while not np.array_equal(parents, parents[parents]):
        motions = compose(motions[parents], motions)
        parents = parents[parents]
    return np.asarray(compose(guess[parents], motions))


def chordal_start(system: System, guess: Array, anchors: Index) -> Array:
    """Poses (N, 3 or 4, 4) by the chordal relaxation.

    Rotations as free matrices, projected; then positions. Linear twice, so no local minimum.
    Carlone, Tron, Daniilidis, Dellaert, "Initialization techniques for 3D SLAM" (2015). The poses
    of `anchors` (A,) in `guess` (N, 3 or 4, 4) are kept.
    """
    planar, tails, heads = system.planar, system.tails, system.heads
    full = planar_to_matrix(guess) if planar else guess
    motion = planar_to_matrix(system.measured) if planar else system.measured
    size = 2 if planar else 3
    turn, shift = (slice(2, 3), slice(0, 2)) if planar else (slice(0, 3), slice(3, 6))
    diagonal = system.information.diagonal(0, 1, 2)
    kappa, tau = _mean(diagonal[:, turn]), _mean(diagonal[:, shift])
    # The minimum of the sum of `kappa |X_j - M' X_i|^2` over `X = R'`.
    held, right = full[anchors, :size, :size].swapaxes(1, 2), np.zeros((len(full), size, size))
    turns = motion[:, :size, :size]
    relaxed = solve_weighted(tails, heads, turns, kappa, anchors, held, right)
    rotations = nearest_rotations(relaxed.swapaxes(1, 2))
    step = np.einsum("eij,ej->ei", rotations[tails], motion[:, :size, 3])
    poses = np.zeros((len(guess), 4, 4))
    poses[:, :size, :size], poses[:, size:, size:] = rotations, np.eye(4 - size)
    poses[:, :size, 3] = _positions(full[:, :size, 3], anchors, tails, heads, step, tau)
    found = matrix_to_planar(poses) if planar else poses
    found[anchors] = guess[anchors]
    return found


def _mean(numbers: Array) -> Array:
    """(E,) means of numbers (E, K); numpy's own takes a small graph several times as long."""
    return np.asarray(np.add.reduce(numbers, axis=1) / numbers.shape[1])


def nearest_rotations(matrices: Array) -> Array:
    """The rotations nearest to matrices in the Frobenius norm, (N, d, d) both."""
    found: Array = np.empty(matrices.shape)
    if matrices.shape[-1] == 2:
        turn = np.arctan2(
            matrices[:, 1, 0] - matrices[:, 0, 1], matrices[:, 0, 0] + matrices[:, 1, 1]
        )
        found[:, 0, 0] = found[:, 1, 1] = np.cos(turn)
        found[:, 1, 0] = sin = np.sin(turn)
        found[:, 0, 1] = -sin
        return found
    left, _, right = np.linalg.svd(matrices)
    left[:, :, 2] *= np.linalg.det(left @ right)[:, None]
    return np.asarray(left @ right)


# Weight of the anchors against the largest weight of an edge: they stay where they are.
_ANCHOR = 1e3


def solve_weighted(
    tails: Index, heads: Index, turns: Array, weights: Array, anchors: Index, held: Array,
    right: Array,
) -> Array:  # fmt: skip
    """X' (N, d, K) that minimises the sum of `weight |X_head - X_tail T|^2` over edges, less
    `2 right X'`; anchors keep what is `held` of it, but for a share that is too small to matter.

    Edges lead from `tails` to `heads`, (E,) both; T are `turns` (E, d, d), with `weights` (E,).
    `held` (A, d, K) is of `anchors` (A,); `right` (N, d, K) is changed. Where d is 1, its axis may
    be absent from `held`, `right` and X'.
    """
    order = colamd_order_of(len(right), tails, heads)
    alike, place = weights[:, None, None] * np.eye(turns.shape[1]), place_in(order)
    matrix = edge_blocks(len(right), place[tails], place[heads], turns, alike)
    anchor = _ANCHOR * float(weights.max(initial=1.0))
    firm = np.zeros((len(right), turns.shape[1]))
    firm[place[anchors]] = anchor
    right[anchors] += anchor * held
    found = matrix.plus(diagonals(firm)).factorised(order)
    return found.solve(right.reshape(firm.size, -1)).reshape(right.shape)


def _positions(
    guess: Array, anchors: Index, tails: Index, heads: Index, step: Array, tau: Array
) -> Array:
    """Positions (N, d) minimising the sum of `tau |t_j - t_i - step|^2`."""
    pull, right = tau[:, None] * step, np.zeros(guess.shape)
    np.add.at(right, heads, pull)
    np.subtract.at(right, tails, pull)
    alike = np.ones((len(tau), 1, 1))
    return solve_weighted(tails, heads, alike, tau, anchors, guess[anchors], right)


def with_places(system: System, poses: Array) -> Array:
    """These `poses` moved to where edges want them, (N, 3 or 4, 4) both; nodes that stay, stay."""
    planar, held = system.planar, np.flatnonzero(system.free < 0)
    where = np.s_[:, :2] if planar else np.s_[:, :3, 3]
    turned, diagonal = poses[system.tails], np.einsum("eii->ei", system.information)
    turned[where] = 0.0
    step = (compose_planar if planar else np.matmul)(turned, system.measured)[where]
    tau = _mean(diagonal[:, slice(0, 2) if planar else slice(3, 6)])
    found = poses.copy()
    found[where] = _positions(poses[where], held, system.tails, system.heads, step, tau)
    found[held] = poses[held]
    return found
