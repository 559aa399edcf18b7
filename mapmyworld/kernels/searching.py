"""Looking a number up among sorted ones.

`np.searchsorted` inside a kernel brings complex numbers and those that are none to be compiled as
well: half a second of a first start.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from mapmyworld.kernels.compiling import inner_jit


@inner_jit
def first_not_below(ascending: NDArray[np.int64], wanted: int) -> int:
    """The first place of `ascending` (N,) that is not below `wanted`; N if there is none."""
    low, high = 0, len(ascending)
    while low < high:
        middle = (low + high) // 2
        if ascending[middle] < wanted:
            low = middle + 1
        else:
            high = middle
    return low
