"""Signals that end the work in order, wherever they strike.

An exception that a handler raises comes between any two steps of the program. Inside the code that
takes and gives back locks (imports, queues, pools of threads, the compiler) it leaves a lock held,
and other threads wait for it for ever; in a callback from C, or of a weak reference, it is printed
and lost. So it is raised only where the program's own code runs. Elsewhere the wish is kept, and
looked at again a moment later; and once more where a stage reports, should it have been lost.
"""

from __future__ import annotations

import math
import signal
import threading
import time
from collections.abc import Callable
from types import FrameType

_AGAIN_AFTER_S = 0.002
_PATIENCE_S = 1.0
"""Then other people's code is ended too, but what takes locks."""
_MOST_CALLS = 3  # so many times Ctrl-C: whatever the program waits for, it ends at once
_OURS = frozenset({"cli", "formats", "mapmyworld"})
# These hand work from thread to thread: both must know how it ended.
HANDING_OVER = frozenset({"mapmyworld.parallel", "mapmyworld.particles.threads"})
_LOCKING = frozenset(
    {
        "_frozen_importlib", "_frozen_importlib_external", "_weakrefset", "asyncio", "concurrent",
        "contextlib", "distributed", "functools", "importlib", "llvmlite", "logging", "numba",
        "queue", "threading", "tornado", "weakref", "zipimport",
    }
)  # fmt: skip

_UNDER_WAY_S = 0.5  # so long nothing is raised again: what was raised is being seen to

_wish: type[BaseException] | None = None
_since = 0.0
_raised = -math.inf
_calls = 0
_working = False


class Interrupted(BaseException):
    """Ctrl-C. Python remembers a KeyboardInterrupt that has passed through code made from text, as
    of dataclasses and named tuples, and then ends by the signal, not with our exit code.
    """


def ending_with(exception: type[BaseException]) -> Callable[[int, FrameType | None], None]:
    """A signal handler that raises as soon as it may, and keeps the wish until `forget_wish`."""

    def end_soon(number: int, frame: FrameType | None) -> None:
        global _wish, _since, _raised
        now = time.monotonic()
        if number == signal.SIGALRM and _wish is None:
            return  # an alarm that was set before the wish was forgotten
        if _wish is None:
            _wish, _since = exception, now
        if number == signal.SIGINT:
            _count_call()
        if now - _raised < _UNDER_WAY_S:
            return
        if may_end(frame, now - _since):
            signal.setitimer(signal.ITIMER_REAL, 0)
            _raised = now
            raise _wish
        signal.signal(signal.SIGALRM, end_soon)
        signal.setitimer(signal.ITIMER_REAL, _AGAIN_AFTER_S)

    return end_soon


def _count_call() -> None:
    """Ends the process if Ctrl-C came too often, or when it ends anyway."""
    global _calls
    _calls += 1
    if _calls >= _MOST_CALLS or not threading.main_thread().is_alive():
        signal.signal(signal.SIGINT, signal.SIG_DFL)
        signal.raise_signal(signal.SIGINT)


def may_end(frame: FrameType | None, waited_s: float) -> bool:
    """Whether an exception raised in this frame, the innermost, leaves all in order."""
    if frame is None or not _working:
        return True
    if _package(frame) in _OURS:
        return _module(frame) not in HANDING_OVER
    if waited_s < _PATIENCE_S:
        return False
    return _package(frame) not in _LOCKING or _waits_for_others(frame)


def _waits_for_others(frame: FrameType) -> bool:
    """Whether it sleeps until another thread says something, where an exception does no harm.

    `Condition.wait` takes its lock again whatever ends it; `gotit` is there once it sleeps.
    """
    if frame.f_code.co_name != "wait" or "gotit" not in frame.f_locals:
        return False
    caller = frame.f_back
    while caller is not None and _package(caller) in {"threading", "queue", "concurrent"}:
        caller = caller.f_back
    return caller is None or _module(caller) not in HANDING_OVER


def _module(frame: FrameType) -> str:
    return str(frame.f_globals.get("__name__", ""))


def _package(frame: FrameType) -> str:
    return _module(frame).partition(".")[0]


def is_wished(kind: type[BaseException]) -> bool:
    """Whether it was asked for and has not been seen to: others' code may have made it an error."""
    return _wish is kind


def heed_wish() -> None:
    """Raises what a signal asked for and no one has got yet."""
    if _wish is not None:
        raise _wish


def forget_wish(kind: type[BaseException]) -> None:
    """The work that it was to end has ended."""
    global _wish, _raised
    if _wish is kind:
        _wish, _raised = None, -math.inf
        signal.setitimer(signal.ITIMER_REAL, 0)


def heed_interrupts() -> None:
    """From now on Ctrl-C ends the work in order."""
    global _working, _calls
    _working, _calls = True, 0
    if signal.getsignal(signal.SIGINT) in (signal.default_int_handler, signal.SIG_DFL):
        signal.signal(signal.SIGINT, ending_with(Interrupted))


def forget_interrupts() -> None:
    """The command has ended, and nothing is left to be ended."""
    global _working
    _working = False
    forget_wish(Interrupted)
