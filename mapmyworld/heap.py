"""Memory that was freed and that the C library keeps."""

from __future__ import annotations

import ctypes
import sys


def give_back() -> None:
    """Returns it to the system: glibc keeps what lies between blocks in use for what comes next,
    and what is large comes on top of it.
    """
    if sys.platform == "linux":
        trim = getattr(ctypes.CDLL(None), "malloc_trim", None)  # musl has none
        if trim is not None:
            trim(0)
