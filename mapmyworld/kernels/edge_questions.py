"""What many edges ask of a factorised matrix, each carried up the tree of its elimination.

Cliques are numbered in the order of elimination, children before parents, and laid out as in
`elimination.solve_in_place`. Nodes are places in that order, -1 for those that do not move.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from mapmyworld.kernels.compiling import inner_jit, jit

Floats = NDArray[np.float64]
Index = NDArray[np.int64]


@jit
def meeting_cliques(
    tails: Index,
    heads: Index,
    owner: Index,
    parents: Index,
    begins: Index,
    rows: Index,
    found: Index,
) -> None:
    """Sets the first clique (E,) that sees all that is left of each edge; -1 where none moves.

    `owner` (N,) eliminates a place, `parents` (C,) are -1 for roots.
    """
    for e in range(len(tails)):
        low, high = min(tails[e], heads[e]), max(tails[e], heads[e])
        if low < 0:
            found[e] = owner[high] if high >= 0 else -1
            continue
        a, b = owner[low], owner[high]
        for k in range(begins[a], begins[a + 1]):
            if rows[k] == high:
                b = a
        while a != b:
            if a < b:
                a = parents[a] if parents[a] >= 0 else b
            else:
                b = parents[b] if parents[b] >= 0 else a
        found[e] = a


@inner_jit
def _eliminate(
    first: int,
    width: int,
    factor: Floats,
    later: Index,
    x: Floats,
    known: Floats,
    linked: Floats,
    found: Floats,
) -> None:
    """Solves for a clique's own numbers of x (K, N), and takes them off what it is linked to."""
    count, height = len(x), len(later) * len(x)
    for k in range(count):
        for i in range(height):
            linked[k, i] = 0.0
    for j in range(width):
        asked, place, below = 0.0, j * width, width * width + j * height
        for k in range(count):
            known[k] = x[k, first + j] / factor[place + j]
            x[k, first + j] = 0.0
            asked += abs(known[k])
        if asked == 0.0:
            continue
        for k in range(count):
            for m in range(count):
                found[k, m] += known[k] * known[m]
            for i in range(j + 1, width):
                x[k, first + i] -= factor[place + i] * known[k]
            for i in range(height):
                linked[k, i] += factor[below + i] * known[k]
    for k in range(count):
        for i in range(height):
            x[k, later[i // count] * count + i % count] -= linked[k, i]


@jit
def carry_up(
    bounds: Index,
    begins: Index,
    rows: Index,
    starts: Index,
    values: Floats,
    owner: Index,
    parents: Index,
    tails: Index,
    heads: Index,
    by_tail: Floats,
    by_head: Floats,
    stops: Index,
    offsets: Index,
    found: Floats,
    left: Floats,
) -> None:
    """Adds to `found` (E, d, d) what cliques below `stops` answer; the rest is `left` for these.

    That are the columns (F, d) over the front of the clique, at `offsets` (E,).
    """
    size, highest = by_tail.shape[1], 0
    for c in range(len(starts) - 1):
        highest = max(highest, begins[c + 1] - begins[c])
    x, known = np.zeros((size, bounds[-1] * size)), np.empty(size)
    linked = np.empty((size, highest * size))
    for e in range(len(tails)):
        stop = stops[e]
        if stop < 0:
            continue
        at = stop, stop
        for end in range(2):
            place, jacobian = (heads[e], by_head[e]) if end else (tails[e], by_tail[e])
            if place >= 0:
                reached = min(owner[place], stop)
                at = (at[0], reached) if end else (reached, at[1])
                for k in range(size):
                    for i in range(size):
                        x[k, place * size + i] += jacobian[k, i]
        a, b = at
        while min(a, b) != stop:
            c = min(a, b)
            width, later = (bounds[c + 1] - bounds[c]) * size, rows[begins[c] : begins[c + 1]]
            factor = values[starts[c] : starts[c + 1]]
            _eliminate(bounds[c] * size, width, factor, later, x, known, linked, found[e])
            after = parents[c] if parents[c] >= 0 else stop
            a, b = after if a == c else a, after if b == c else b
        row = offsets[e]
        own = (bounds[stop + 1] - bounds[stop]) * size
        for i in range(own + (begins[stop + 1] - begins[stop]) * size):
            place = bounds[stop] * size + i
            if i >= own:
                later_node = rows[begins[stop] + (i - own) // size]
                place = later_node * size + (i - own) % size
            for k in range(size):
                left[row, k] = x[k, place]
                x[k, place] = 0.0
            row += 1
