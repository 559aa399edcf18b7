"""RVL: 16-bit depth images as RTAB-Map and cameras compress them; we read it alone.

Wilson, "Fast lossless depth image compression" (2017): runs of zeros and of valid pixels, the
latter as zigzag differences, all numbers in groups of three bits per nibble. Imported where such an
image is: to open a log takes no numba.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from mapmyworld.kernels.compiling import jit


def _decode(words: Any, pixels: Any) -> bool:
    """Fills `pixels`; whether the words held exactly so many. The loops are numba's to compile."""
    at, i, n, total = 0, np.int64(0), len(pixels), 8 * len(words)
    # `pending`: valid pixels of the last run; 1 at first, as an image may begin with one.
    previous, pending, left = np.int64(0), np.int64(1), np.int64(0)
    is_zeros = True
    while i < n:
        value, bits, more = np.int64(0), 0, True
        while more:
            if at >= total or bits > 30:
                return False
            nibble = (words[at >> 3] >> np.uint32(28 - 4 * (at & 7))) & np.uint32(15)
            at += 1
            value |= np.int64(nibble & 7) << bits
            bits += 3
            more = nibble >= 8
        if left > 0:
            previous += (value >> 1) ^ -(value & 1)
            pixels[i] = previous & 0xFFFF
            i += 1
            left -= 1
        elif is_zeros:
            # Two empty runs in a row would go on for ever without a pixel.
            if value > n - i or (value == 0 and pending == 0):
                return False
            pixels[i : i + value] = 0
            i += value
            is_zeros = False
        else:
            if value > n - i:
                return False
            left, is_zeros = value, True
            pending = value
    return True


# Called, not decorated, so that the type checker sees it.
_decode_words = jit(_decode)


def rvl_decode(words: bytes, height: int, width: int) -> NDArray[np.uint16]:
    """Depth (H, W) of RVL words, of that height and width; ValueError when they do not hold it."""
    pixels = np.empty(height * width, np.uint16)
    padded = words + b"\0" * (-len(words) % 4)
    if not _decode_words(np.frombuffer(padded, "<u4").astype(np.uint32), pixels):
        raise ValueError(f"RVL data do not hold {width} x {height} pixels")
    return pixels.reshape(height, width)
