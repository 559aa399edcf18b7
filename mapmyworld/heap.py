"""Memory that was freed and that the C library keeps."""

from __future__ import annotations

import ctypes

_MOST_ARENAS = -8  # glibc's M_ARENA_MAX


def share_one_heap() -> None:
    """All threads take memory from one heap, from now on.

    glibc gives each thread its own, up to eight a core, and what one has freed no other may use.
    """
    limit = getattr(ctypes.CDLL(None), "mallopt", None)  # musl and macOS have none
    if limit is not None:
        limit(_MOST_ARENAS, 1)


def give_back() -> None:
    """Returns it to the system: glibc keeps what lies between blocks in use for what comes next,
    and what is large comes on top of it.
    """
    trim = getattr(ctypes.CDLL(None), "malloc_trim", None)
    if trim is not None:
        trim(0)
