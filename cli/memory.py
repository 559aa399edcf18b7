"""How much memory this process holds, and a limit that ends it in good order."""

from __future__ import annotations

import _thread
import resource
import signal
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from cli.exit_codes import EXIT_BAD_INPUT
from cli.interrupts import Ending, ending_with, forget_wish, is_wished
from mapmyworld.errors import MapMyWorldError

_LOOK_EVERY_S = 0.1


class MemoryLimitError(MapMyWorldError):
    """More memory was needed than allowed."""


class _Over(Ending):
    """More than `--max-memory`."""

    exit_code = EXIT_BAD_INPUT


def resident_mb() -> float:
    """What the process holds now."""
    pages = int(Path("/proc/self/statm").read_text("ascii").split()[1])
    return pages * resource.getpagesize() / (1 << 20)


def peak_memory_mb() -> float:
    """The most memory that this process has held.

    Linux indicates it of the program alone; what getrusage indicates may be that of who started it.
    """
    try:
        status = Path("/proc/self/status").read_text("ascii")
        return int(status.partition("VmHWM:")[2].split()[0]) / 1024
    except (OSError, ValueError, IndexError):
        return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024


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
            f"more than {megabytes} MB (--max-memory) are needed: raise it and repeat the command "
            "to resume; or set sensing.node_distance higher"
        ) from None
    finally:
        done.set()
        forget_wish(_Over)
        signal.signal(signal.SIGUSR1, before)
