"""The elimination's kernels against plain twins."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from mapmyworld.graph.cholesky import factorise
from mapmyworld.graph.elimination import analyse, links
from mapmyworld.kernels.elimination import add_update, column_structures, gathered_columns


def later_links(count: int, number: int, seed: int) -> list[set[int]]:
    rng = np.random.default_rng(seed)
    found: list[set[int]] = [set() for _ in range(count)]
    for a, b in np.sort(rng.integers(0, count, (number, 2)), axis=1).tolist():
        if a < b:
            found[a].add(b)
    return found


def structures(own: list[set[int]]) -> list[set[int]]:
    """By the definition: eliminating a column links all that it is linked to."""
    found = [set(links) for links in own]
    for column in found:
        if column:
            found[min(column)] |= column - {min(column)}
    return found


@settings(max_examples=50)
@given(st.integers(1, 30), st.integers(0, 60), st.integers(0, 1000))
def test_structures_are_those_of_the_definition(count: int, number: int, seed: int) -> None:
    own = later_links(count, number, seed)
    first = np.cumsum([0, *map(len, own)])
    later = np.array([k for links in own for k in sorted(links, reverse=True)], np.int64)
    begins, found = column_structures(first, later)
    columns = [found[a:b].tolist() for a, b in pairwise(begins)]
    assert [set(c) for c in columns] == structures(own)
    assert all(len(c) == len(set(c)) for c in columns)
    assert all(c[0] == min(c) for c in columns if c)


@settings(max_examples=50)
@given(st.integers(1, 30), st.integers(0, 60), st.integers(0, 1000))
def test_gathered_columns_are_chains_of_the_tree(count: int, number: int, seed: int) -> None:
    below = structures(later_links(count, number, seed))
    parents = np.array([min(c) if c else -1 for c in below])
    heights = np.array([len(c) for c in below])
    none = np.array([4, 10**9]), np.array([0.0, 0.0])
    order, ends = gathered_columns(parents, heights, *none)
    assert sorted(order.tolist()) == list(range(count))
    place = np.argsort(order)
    assert all(place[k] < place[p] for k, p in enumerate(parents.tolist()) if p >= 0)
    for a, b in pairwise([0, *ends.tolist()]):
        group = order[a:b].tolist()
        # Without a single zero allowed, columns of a group share one structure.
        everything = set(group) | below[group[-1]]
        assert all(below[k] == {n for n in everything if place[n] > place[k]} for k in group)


def test_an_update_is_added_where_it_belongs() -> None:
    rng = np.random.default_rng(0)
    front, update = (rng.normal(size=(n, n)) for n in (6, 3))
    into = np.array([1, 2, 5])
    wanted = front.copy()
    wanted[np.ix_(into, into)] += update
    add_update(front, into, update)
    assert np.allclose(np.tril(front), np.tril(wanted), atol=0, rtol=1e-15)


@settings(max_examples=20)
@given(st.integers(2, 40), st.integers(0, 80), st.sampled_from([1, 3]), st.integers(0, 1000))
def test_factors_solve_what_numpy_solves(count: int, number: int, size: int, seed: int) -> None:
    rng = np.random.default_rng(seed)
    ends = rng.integers(0, count, (number, 2))
    ends = ends[ends[:, 0] != ends[:, 1]]
    rows, columns, _ = links(count, ends[:, 0], ends[:, 1])
    blocks = rng.normal(size=(len(rows), size, size))
    blocks[:count] = 10.0 * count * np.eye(size)
    dense = np.zeros((count, size, count, size))
    for row, column, block in zip(rows, columns, blocks, strict=True):
        dense[row, :, column], dense[column, :, row] = block, block.T
    right = rng.normal(size=count * size)
    wanted = np.linalg.solve(dense.reshape(count * size, -1), right)
    assert np.allclose(factorise(analyse(count, rows, columns, size), blocks).solve(right), wanted)
