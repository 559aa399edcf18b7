"""Connected components of a graph, and which node of each has to stay."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from mapmyworld.geometry import Index


def components(node_count: int, tails: Index, heads: Index) -> Index:
    """(N,) number of the component of every node, by edges `tails`, `heads` (E,).

    Connected components are numbered by their first nodes.
    """
    first = first_nodes(node_count, tails, heads)
    return np.asarray(np.unique(first, return_inverse=True)[1], np.int64)


def first_nodes(node_count: int, tails: Index, heads: Index) -> Index:
    """(N,) the first node of the component of every node, by edges `tails`, `heads` (E,)."""
    first = np.arange(node_count)
    while True:  # each part that is known joins the first of its neighbours
        joined, ends = first.copy(), (first[tails], first[heads])
        for end in ends:
            np.minimum.at(joined, end, np.minimum(*ends))
        joined = _rooted(joined)
        if np.array_equal(joined, first):
            return first
        first = joined


def _rooted(parents: Index) -> Index:
    """(N,) where the `parents` (N,) of every node end; roots are their own."""
    while not np.array_equal(parents, above := parents[parents]):
        parents = above
    return parents


def held_nodes(node_count: int, tails: Index, heads: Index, held: Index) -> NDArray[np.bool_]:
    """(N,) nodes that are `held` (K,), and the first node of every connected component without any.

    Edges lead from `tails` (E,) to `heads` (E,).
    """
    first = first_nodes(node_count, tails, heads)
    found, placed = np.zeros((2, node_count), np.bool_)
    placed[first[held]] = True
    found[first[~placed[first]]] = True
    found[held] = True
    return found


def positions(known: Index, wanted: Index) -> Index:
    """(W,) where `wanted` ids (W,) stand in the ascending `known` (K,); -1 for absent ones."""
    if len(known) == 0 or len(wanted) == 0:
        return np.full(len(wanted), -1, np.int64)
    found = np.minimum(known.searchsorted(wanted), len(known) - 1)
    return np.where(known[found] == wanted, found, -1)
