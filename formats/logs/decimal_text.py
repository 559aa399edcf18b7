"""Decimal numbers in text, many a microsecond, exactly as Python reads them."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from formats.kernels import compiled

_SPACE, _NEWLINE, _RETURN, _TAB, _MINUS, _POINT, _ZERO, _NINE = 32, 10, 13, 9, 45, 46, 48, 57
_EXACT = 1 << 53  # digits make an integer below: it and the power of ten are exact, so is the rest
_MOST_DECIMALS = 22


@compiled
def read_decimals(text: NDArray[np.uint8], start: int, values: NDArray[np.float64]) -> int:
    """Fills `values` with the numbers from `start` on; the place behind the last one.

    -1 where the text holds fewer, or one that is not plain: `float` decides about those.
    """
    i, size = start, len(text)
    for k in range(len(values)):
        while i < size and (text[i] == _SPACE or text[i] == _TAB):
            i += 1
        negative = i < size and text[i] == _MINUS
        if negative:
            i += 1
        digits, decimals, seen, behind = 0, 0, 0, False
        while i < size:
            c = text[i]
            if _ZERO <= c <= _NINE:
                digits = 10 * digits + (c - _ZERO)
                seen += 1
                decimals += behind
                if digits >= _EXACT:
                    return -1
            elif c == _POINT and not behind:
                behind = True
            else:
                break
            i += 1
        ends = i == size or text[i] in (_SPACE, _NEWLINE, _RETURN, _TAB)
        if seen == 0 or not ends or decimals > _MOST_DECIMALS:
            return -1
        value = digits / 10.0**decimals
        values[k] = -value if negative else value
    return i
