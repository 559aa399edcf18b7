"""What a factorised information says about linear functions of its unknowns."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from mapmyworld.geometry import Array, Index
from mapmyworld.kernels.compiling import jit

Small = NDArray[np.int32]
_TOGETHER = 48  # rows: neighbours reach nearly the same columns, and a processor works on several


@jit
def predict(
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

    L (n, n) by columns: `starts` (n + 1,), `rows` and `numbers` (K,), with `diagonal` (n,) D. J
    (R, n) by rows: `asked_starts` (R + 1,), `asked_columns` and `asked` (M,); `groups` and `ends`
    (G + 1,). Groups are carried together up the columns of L that they reach, and each gives its
    share as it is passed.
    """
    count, last, widest = len(diagonal), len(groups) - 1, _TOGETHER
    for g in range(last):
        widest = max(widest, groups[g + 1] - groups[g])
    carried, reached = np.zeros((count, widest)), np.zeros(count, np.bool_)
    begin = end = 0
    while end < last:
        begin, end = end, end + 1
        while end < last and groups[end + 1] - groups[begin] <= _TOGETHER:
            end += 1
        first, width, lowest = groups[begin], groups[end] - groups[begin], count
        for r in range(width):
            for p in range(asked_starts[first + r], asked_starts[first + r + 1]):
                column = asked_columns[p]
                carried[column, r] += asked[p]
                reached[column], lowest = True, min(lowest, column)
        for j in range(lowest, count):
            if not reached[j]:
                continue
            reached[j], own = False, carried[j, :width]
            for g in range(begin, end):
                mine = own[groups[g] - first : groups[g + 1] - first]
                for a in range(len(mine)):
                    for b in range(len(mine)):
                        found[ends[g] + a * len(mine) + b] += mine[a] * mine[b] / diagonal[j]
            for p in range(starts[j], starts[j + 1]):
                i = rows[p]
                if i > j:
                    reached[i], above, number = True, carried[i, :width], numbers[p]
                    for a in range(width):
                        above[a] -= number * own[a]
            own[:] = 0.0
