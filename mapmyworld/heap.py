"""The heap: what was freed goes back to the system, what stays is not searched for garbage."""

from __future__ import annotations

import ctypes
import functools
import gc
from collections.abc import Callable, Iterator
from contextlib import contextmanager


def give_back() -> None:
    """Returns what is free to the system, where the C library can (glibc); takes milliseconds.

    The library keeps much of it otherwise, above all after images.
    """
    trim = _trimmer()
    if trim is not None:
        trim(0)


@functools.cache
def _trimmer() -> Callable[[int], int] | None:
    try:
        trim: Callable[[int], int] = ctypes.CDLL(None).malloc_trim
    except (AttributeError, OSError, TypeError):  # another C library, or none to ask
        return None
    return trim


@contextmanager
def no_search_for_garbage(*, spare: bool = False) -> Iterator[None]:
    """For work that makes objects by the ten thousand, nearly all of which stay.

    Python would look through all of them now and then: 0.1 s of imports, an eighth of compiling.
    `spare`: what there is at the end is never looked at, for the first who asks; what is garbage
    by then is never reported.
    """
    searched = gc.isenabled()
    gc.disable()
    try:
        yield
    finally:
        if spare and gc.get_freeze_count() == 0:
            gc.freeze()
        if searched:
            gc.enable()
