"""Ctrl-C and the memory limit end the work in order.

Ctrl-C only notes the wish, which is raised where a stage next reports how far it is, between two
steps of our own code. Where nothing reports for a second, it is raised in the main thread wherever
that is, as Python does; should a lock be left held there and the work not end, the process does,
which maps survive.
"""

from __future__ import annotations

import os
import resource
import signal
import sys
from pathlib import Path
from types import FrameType

from cli.exit_codes import EXIT_INTERRUPTED
from mapmyworld.errors import MapMyWorldError

_REPORTS_WITHIN_S = 1.0
_CLEARS_UP_WITHIN_S = 20.0
_MOST_CALLS = 3  # so many times Ctrl-C: whatever the program waits for, it ends at once
_raised = False
_calls = 0
_others = sys.unraisablehook


class Interrupted(BaseException):
    """Ctrl-C. Python remembers a KeyboardInterrupt that has passed through code made from text, as
    of dataclasses and named tuples, and then ends by the signal, not with our exit code.
    """


def _note(_number: int, _: FrameType | None) -> None:
    global _calls
    if not _calls:
        signal.signal(signal.SIGALRM, _not_heeded)
        signal.setitimer(signal.ITIMER_REAL, _REPORTS_WITHIN_S)
    _calls += 1
    if _calls == _MOST_CALLS - 1:  # what runs C code gives this handler no turn
        signal.signal(signal.SIGINT, signal.SIG_DFL)


def _not_heeded(_number: int, _: FrameType | None) -> None:
    if _raised:
        os.write(2, b"mapmyworld: ended at once; the same command goes on with this stage\n")
        os._exit(EXIT_INTERRUPTED)
    heed_wish()


def is_interrupted() -> bool:
    """Whether Ctrl-C was pressed: others' code may have made an error of what was raised."""
    return _calls > 0


def heed_wish() -> None:
    """Raises `Interrupted` where Ctrl-C was pressed."""
    global _raised
    if _calls:
        if not _raised:
            _raised = True
            signal.setitimer(signal.ITIMER_REAL, _CLEARS_UP_WITHIN_S)
        raise Interrupted


def _keep_quiet(dropped: sys.UnraisableHookArgs) -> None:
    """What was raised while Python cleared an object away: the next report raises it once more."""
    if not isinstance(dropped.exc_value, Interrupted):
        _others(dropped)


def heed_interrupts() -> None:
    """From now on Ctrl-C ends the work in order."""
    global _others
    if sys.unraisablehook is not _keep_quiet:
        _others, sys.unraisablehook = sys.unraisablehook, _keep_quiet
    if signal.getsignal(signal.SIGINT) in (signal.default_int_handler, signal.SIG_DFL):
        signal.signal(signal.SIGINT, _note)


def forget_interrupts() -> None:
    """The command has ended: nothing is left that would have to end in order."""
    global _calls, _raised
    if _calls:
        _calls, _raised = 0, False
        signal.setitimer(signal.ITIMER_REAL, 0)
    if sys.unraisablehook is _keep_quiet:
        sys.unraisablehook = _others
    if signal.getsignal(signal.SIGINT) is not signal.SIG_IGN:
        signal.signal(signal.SIGINT, signal.SIG_DFL)


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


def heed_memory_limit(megabytes: int | None) -> None:
    """Raises `MemoryLimitError` where the process holds more; None = no limit.

    So a map keeps what is finished; a kill by the system would not ask.
    """
    if megabytes is not None and resident_mb() > megabytes:
        raise MemoryLimitError(
            f"more than {megabytes} MB (--max-memory) are needed: raise it and repeat the command "
            "to resume; or set sensing.node_distance higher"
        )
