"""What a factorised information says about linear functions of its unknowns."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from mapmyworld.geometry import Array, Index
from mapmyworld.kernels.compiling import jit

Small = NDArray[np.int32]


@jit
def predict(
    first: int,
    last: int,
    starts: Small,
    rows: Small,
    numbers: Array,
    diagonal: Array,
    asked_starts: Small,
    asked_columns: Index,
    asked: Array,
    groups: Index,
    ends: Index,
    found: Array,
) -> None:
    """Adds `J inverse(L D L') J'` to `found` (F,), for every group of rows of J, from `ends[g]` on.

    Groups are those from `first` to before `last`. They are carried together up the columns of L
    that they reach, and each gives its share as it is passed: neighbours reach nearly the same.

    L (n, n) by columns: `starts` (n + 1,), `rows` and `numbers` (K,), with `diagonal` (n,) D. J
    (R, n) by rows: `asked_starts` (R + 1,), `asked_columns` and `asked` (M,); `groups` and `ends`
    (G + 1,).
    """
    count, begin, width = len(diagonal), groups[first], groups[last] - groups[first]
    carried, reached, lowest = np.zeros((count, width)), np.zeros(count, np.bool_), count
    for r in range(width):
        for p in range(asked_starts[begin + r], asked_starts[begin + r + 1]):
            column = asked_columns[p]
            carried[column, r] += asked[p]
            reached[column], lowest = True, min(lowest, column)
    for j in range(lowest, count):
        if not reached[j]:
            continue
        own = carried[j]
        for g in range(first, last):
            mine = own[groups[g] - begin : groups[g + 1] - begin]
            for a in range(len(mine)):
                for b in range(len(mine)):
                    found[ends[g] + a * len(mine) + b] += mine[a] * mine[b] / diagonal[j]
        for p in range(starts[j], starts[j + 1]):
            i = rows[p]
            if i > j:
                reached[i], above, number = True, carried[i], numbers[p]
                for a in range(width):
                    above[a] -= number * own[a]
