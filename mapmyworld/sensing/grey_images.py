"""16-bit grey images: separated from depth in millimetres by name, made 8-bit."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from mapmyworld.errors import LogError
from mapmyworld.types import ImageMessage, Message

_UNITS = 1000.0  # in a metre of what readers take for depth, REP-118
_EIGHT = 8


def is_grey(topic: str, encoding: str, others: Sequence[tuple[str, str]]) -> bool:
    """Whether a mono16 image is a picture: its name does not say depth, and another one is depth.

    `others`: topic and encoding of all depth images in the log, this one included.
    """
    if encoding.lower() != "mono16" or "depth" in topic.lower():
        return False
    return any(
        other != topic and ("depth" in other.lower() or kind.lower() != "mono16")
        for other, kind in others
    )


def bits_of(samples: Sequence[Message]) -> int:
    """Bits that a stream's pictures use: 8, 10, 12, 14 or 16, as cameras have them."""
    brightest = 0
    for message in samples:
        try:
            if isinstance(message, ImageMessage):
                brightest = max(brightest, int(_cells(message).max(initial=0)))
        except LogError:
            continue
    used = max(brightest.bit_length(), _EIGHT)
    return used + used % 2


def eight_bits(message: ImageMessage, bits: int) -> ImageMessage:
    """The same picture with pixels of `bits` bits brought to eight."""

    def pixels() -> NDArray[np.generic]:
        return np.asarray(np.minimum(_cells(message) >> (bits - _EIGHT), 255), np.uint8)

    return replace(message, encoding="mono8", pixels=pixels, encoded=None)


def _cells(message: ImageMessage) -> NDArray[np.uint16]:
    """As recorded: what the reader took for millimetres."""
    metres = np.asarray(message.pixels(), np.float64)
    return np.asarray(np.rint(metres * _UNITS), np.uint16)
