"""How much memory this process holds, and a limit that ends it in good order."""

from __future__ import annotations

import resource
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from mapmyworld.errors import MapMyWorldError

_limit_mb: int | None = None


class MemoryLimitError(MapMyWorldError):
    """More memory was needed than allowed."""


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
    """Ends what is done under it where it next reports how far it is, once the process holds more.

    So a map keeps what is finished; a kill by the system would not ask. None = no limit.
    """
    global _limit_mb
    _limit_mb = megabytes
    try:
        yield
    finally:
        _limit_mb = None


def heed_memory_limit() -> None:
    """Raises `MemoryLimitError` where the process holds more than `memory_limit` allows."""
    if _limit_mb is not None and resident_mb() > _limit_mb:
        raise MemoryLimitError(
            f"more than {_limit_mb} MB (--max-memory) are needed: raise it and repeat the command "
            "to resume; or set sensing.node_distance higher"
        )
