"""Memory that was freed and that the C library keeps."""

from __future__ import annotations

import ctypes


def share_one_heap() -> None:
    """All threads take memory from one heap, from now on.

    glibc gives each thread its own, up to eight a core, and what one has freed no other may use.
    """
    mallopt = getattr(ctypes.CDLL(None), "mallopt", None)  # musl and macOS have none
    if mallopt is not None:
        mallopt(-8, 1)  # M_ARENA_MAX


def give_back() -> None:
    """Returns it to the system: glibc keeps what lies between blocks in use for what comes next,
    and what is large comes on top of it.
    """
    trim = getattr(ctypes.CDLL(None), "malloc_trim", None)
    if trim is not None:
        trim(0)
