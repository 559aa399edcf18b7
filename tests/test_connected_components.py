"""Connected components of graphs, and the nodes that hold them, against scipy."""

from __future__ import annotations

import numpy as np
from hypothesis import given
from hypothesis import strategies as st
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from mapmyworld.backend.connected_components import components, held_nodes

NODES = 12
ENDS = st.integers(0, NODES - 1)


@given(st.lists(st.tuples(ENDS, ENDS), max_size=15), st.lists(ENDS, max_size=3))
def test_parts_are_numbered_by_their_first_node_and_held(
    pairs: list[tuple[int, int]], fixed: list[int]
) -> None:
    tails, heads = np.array(pairs, np.int64).reshape(-1, 2).T
    held = np.array(fixed, np.int64)
    linked = coo_array((np.ones(len(tails)), (tails, heads)), shape=(NODES, NODES))
    wanted = connected_components(linked, directed=False)[1]
    number = components(NODES, tails, heads)
    first = [int(np.flatnonzero(wanted == part)[0]) for part in wanted]
    assert number.tolist() == [sorted(set(first)).index(k) for k in first]
    loose = {k for k in first if wanted[k] not in wanted[held]}
    stays = held_nodes(NODES, tails, heads, held)
    assert set(np.flatnonzero(stays).tolist()) == loose | set(fixed)
