"""The elimination of a sparse symmetric matrix: its parts and structure, fronts added to fronts."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from mapmyworld.kernels.compiling import jit
from mapmyworld.kernels.searching import first_not_below

Floats = NDArray[np.float64]
Index = NDArray[np.int64]


@jit
def join_parts(tails: Index, heads: Index, first: Index, number: Index) -> None:
    """Sets the first node (N,) of every node's connected part, from 0, 1, ..., and its number.

    Parts are numbered by their first nodes.
    """
    for e in range(len(tails)):
        a, b = tails[e], heads[e]
        while first[a] != a:
            first[a] = a = first[first[a]]
        while first[b] != b:
            first[b] = b = first[first[b]]
        first[max(a, b)] = min(a, b)
    parts = 0
    for n in range(len(first)):  # whoever comes before knows its own by now
        first[n] = first[first[n]]
        if first[n] == n:
            number[n] = parts
            parts += 1
        else:
            number[n] = number[first[n]]


@jit
def column_structures(first: Index, later: Index) -> tuple[Index, Index]:
    """Where each column's structure begins (N + 1,), and all structures one after the other.

    Column `j` is linked to `later[first[j]:first[j + 1]]`, nodes after it. Its structure is that,
    and what its children in the elimination tree hand on; its lowest node, which comes first,
    is its parent.
    """
    count = len(first) - 1
    begins = np.zeros(count + 1, np.int64)
    found = np.empty(4 * len(later) + count, np.int64)
    marked, child, sibling = np.full(count, -1), np.full(count, -1), np.full(count, -1)
    for j in range(count):
        if begins[j] + count - j > len(found):
            longer = np.empty(2 * len(found) + count, np.int64)
            for place in range(begins[j]):
                longer[place] = found[place]
            found = longer
        end = begins[j]
        for place in range(first[j], first[j + 1]):
            if marked[later[place]] != j:
                marked[later[place]] = j
                found[end] = later[place]
                end += 1
        c = child[j]
        while c >= 0:
            for place in range(begins[c] + 1, begins[c + 1]):
                if marked[found[place]] != j:
                    marked[found[place]] = j
                    found[end] = found[place]
                    end += 1
            c = sibling[c]
        begins[j + 1] = end
        if end > begins[j]:
            lowest = begins[j]
            for place in range(begins[j] + 1, end):
                if found[place] < found[lowest]:
                    lowest = place
            parent = found[lowest]
            found[lowest], found[begins[j]] = found[begins[j]], parent
            sibling[j], child[parent] = child[parent], j
    return begins, found[: begins[count]]


@jit
def gathered_columns(
    parents: Index, heights: Index, widths: Index, shares: Floats
) -> tuple[Index, Index]:
    """Columns in an order in which groups are consecutive, and where each group ends.

    A column takes up those of its children, with what they have taken up, that cost few zeros: a
    group of up to `widths[k]` columns may hold the share `shares[k]` of them. Children come before
    parents. `heights` (N,) count the nodes of a column's structure, `parents` are -1 for roots.
    """
    count = len(parents)
    child, last_child, sibling = np.full(count, -1), np.full(count, -1), np.full(count, -1)
    head, after, columns = np.full(count, -1), np.full(count, -1), np.full(count, 1)
    entries, taken = np.full(count, 0), np.full(count, 0)
    for j in range(count):
        head[j], entries[j] = j, heights[j] + 1
    for j in range(count):
        c = child[j]
        while c >= 0:
            width, both = columns[j] + columns[c], entries[j] + entries[c]
            dense = width * (width + 1) // 2 + width * heights[j]
            allowed = shares[first_not_below(widths, width)]
            if 1.0 - both / dense <= allowed:
                after[c], head[j] = head[j], head[c]
                columns[j], entries[j], taken[c] = width, both, 1
            c = sibling[c]
        parent = parents[j]
        if parent >= 0:
            if child[parent] < 0:
                child[parent] = j
            else:
                sibling[last_child[parent]] = j
            last_child[parent] = j
    order, ends, placed, groups = np.empty(count, np.int64), np.empty(count, np.int64), 0, 0
    for top in range(count):
        if taken[top] == 0:
            column = head[top]
            for _ in range(columns[top]):
                order[placed] = column
                column = after[column]
                placed += 1
            ends[groups] = placed
            groups += 1
    return order, ends[:groups]


@jit
def add_update(front: Floats, into: Index, update: Floats) -> None:
    """Adds `update` (r, r) to the scalars `into` (r,) of a front; lower halves only."""
    for j in range(len(into)):
        for i in range(j, len(into)):
            front[into[i], into[j]] += update[i, j]


@jit
def solve_in_place(
    size: int, bounds: Index, begins: Index, rows: Index, starts: Index, values: Floats, x: Floats
) -> None:
    """Solves with the factor of all cliques for x (N * size,), which is in the factor's order.

    Clique `c` eliminates nodes `bounds[c]` to `bounds[c + 1] - 1` and is linked to
    `rows[begins[c]:begins[c + 1]]`. At `values[starts[c]]` its triangle begins, column by column,
    and behind that what the factor holds below it.
    """
    count = len(starts) - 1
    linked = np.empty(len(rows) * size)
    for c in range(count):
        first, width = bounds[c] * size, (bounds[c + 1] - bounds[c]) * size
        height = (begins[c + 1] - begins[c]) * size
        for k in range(height):
            linked[k] = 0.0
        for j in range(width):
            place = starts[c] + j * width
            below = starts[c] + width * width + j * height
            known = x[first + j] / values[place + j]
            x[first + j] = known
            for i in range(j + 1, width):
                x[first + i] -= values[place + i] * known
            for i in range(height):
                linked[i] += values[below + i] * known
        for k in range(height):
            x[rows[begins[c] + k // size] * size + k % size] -= linked[k]
    for c in range(count - 1, -1, -1):
        first, width = bounds[c] * size, (bounds[c + 1] - bounds[c]) * size
        height = (begins[c + 1] - begins[c]) * size
        for k in range(height):
            linked[k] = x[rows[begins[c] + k // size] * size + k % size]
        for j in range(width - 1, -1, -1):
            place = starts[c] + j * width
            below = starts[c] + width * width + j * height
            left = 0.0
            for i in range(j + 1, width):
                left += values[place + i] * x[first + i]
            for i in range(height):
                left += values[below + i] * linked[i]
            x[first + j] = (x[first + j] - left) / values[place + j]
