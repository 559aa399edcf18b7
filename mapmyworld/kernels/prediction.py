"""What a factorised information says about linear functions of its unknowns."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from mapmyworld.kernels.compiling import jit

Floats = NDArray[np.float64]
Index = NDArray[np.int64]
Small = NDArray[np.int32]


@jit
def predict(
    starts: Small,
    rows: Small,
    numbers: Floats,
    diagonal: Floats,
    asked_starts: Small,
    asked_columns: Index,
    asked: Floats,
    groups: Index,
    ends: Index,
    found: Floats,
) -> None:
    """Adds `J inverse(L D L') J'` to `found` (F,), for every group of rows of J, from `ends[g]` on.

    L (n, n) by columns: `starts` (n + 1,), `rows` and `numbers` (K,), with `diagonal` (n,) D. J
    (R, n) by rows: `asked_starts` (R + 1,), `asked_columns` and `asked` (M,); `groups` and `ends`
    (G + 1,). Each group is carried up the columns of L that it reaches, and each gives its share as
    it is passed.
    """
    count, widest = len(diagonal), 0
    for g in range(len(groups) - 1):
        widest = max(widest, groups[g + 1] - groups[g])
    carried, reached = np.zeros((count, widest)), np.zeros(count, np.bool_)
    for g in range(len(groups) - 1):
        first, width, lowest = groups[g], groups[g + 1] - groups[g], count
        for r in range(width):
            for p in range(asked_starts[first + r], asked_starts[first + r + 1]):
                column = asked_columns[p]
                carried[column, r] += asked[p]
                reached[column], lowest = True, min(lowest, column)
        for j in range(lowest, count):
            if not reached[j]:
                continue
            reached[j] = False
            for a in range(width):
                for b in range(width):
                    share = carried[j, a] * carried[j, b] / diagonal[j]
                    found[ends[g] + a * width + b] += share
            for p in range(starts[j], starts[j + 1]):
                i = rows[p]
                if i > j:
                    reached[i] = True
                    for a in range(width):
                        carried[i, a] -= numbers[p] * carried[j, a]
            carried[j, :width] = 0.0
