"""How much memory this process holds, and a limit that ends it in good order."""

from __future__ import annotations

import _thread
import functools
import gc
import resource
import signal
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import cast

from cli.interrupts import ending_with, forget_wish, is_wished
from mapmyworld.errors import MapMyWorldError

_LOOK_EVERY_S = 0.1


class MemoryLimitError(MapMyWorldError):
    """More memory was needed than allowed."""


class _Over(BaseException):
    """Ends the main thread's work."""


def resident_mb() -> float:
    """What the process holds now."""
    pages = int(Path("/proc/self/statm").read_text("ascii").split()[1])
    return pages * resource.getpagesize() / (1 << 20)


@functools.cache
def _trim() -> Callable[[int], int] | None:
    """The C library's malloc_trim; None where it has none, as only glibc does."""
    import ctypes

    try:
        return cast("Callable[[int], int]", ctypes.CDLL(None).malloc_trim)
    except (AttributeError, OSError):
        return None


def give_back_memory() -> None:
    """Hands to the system what is free, but held by the allocator: images leave much of it."""
    trim = _trim()
    if trim is not None:
        trim(0)


@contextmanager
def memory_limit(megabytes: int | None) -> Iterator[None]:
    """Ends what is done under it once the process holds more; None = no limit.

    It ends in order, so that a map keeps what is finished; a kill by the system would not ask.
    """
    if megabytes is None:
        yield
        return
    done = threading.Event()

    def watch() -> None:
        while not done.wait(_LOOK_EVERY_S):
            if resident_mb() > megabytes:
                _thread.interrupt_main(signal.SIGUSR1)
                return

    before = signal.signal(signal.SIGUSR1, ending_with(_Over))
    threading.Thread(target=watch, daemon=True).start()
    try:
        yield
    except (Exception, _Over):
        if not is_wished(_Over):
            raise
        raise MemoryLimitError(
            f"more than the {megabytes} MB of --max-memory are needed: allow more, and the same "
            "command goes on with this stage; or set sensing.node_distance higher"
        ) from None
    finally:
        done.set()
        forget_wish(_Over)
        signal.signal(signal.SIGUSR1, before)


@contextmanager
def no_search_for_garbage() -> Iterator[None]:
    """For imports, which make objects by the ten thousand: they stay, and are not looked at again.

    Python would look through all of them now and then, which adds up to 0.1 s.
    """
    gc.disable()
    try:
        yield
    finally:
        if gc.get_freeze_count() == 0:  # once: what is garbage by then will never be told
            gc.freeze()
        gc.enable()
