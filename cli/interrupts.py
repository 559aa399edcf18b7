"""Signals that end the work in order, also where Python drops what a handler raises.

An exception raised while a library calls back from C (a compiled kernel being loaded, say) is
printed and ignored. The wish is therefore kept, and asked for again where a stage reports. One
raised inside the import machinery can leave its lock held, and every other thread waiting for it:
there the handler waits until that code has been left.
"""

from __future__ import annotations

import signal
from collections.abc import Callable
from types import FrameType

_wish: type[BaseException] | None = None
_AGAIN_AFTER_S = 0.01


def ending_with(exception: type[BaseException]) -> Callable[[int, FrameType | None], None]:
    """A signal handler that raises, and keeps the wish until `forget_wish`."""

    def raise_it(_signal: int, frame: FrameType | None) -> None:
        global _wish
        _wish = exception
        if _is_importing(frame):
            signal.signal(signal.SIGALRM, raise_it)
            signal.setitimer(signal.ITIMER_REAL, _AGAIN_AFTER_S)
            return
        raise exception

    return raise_it


def _is_importing(frame: FrameType | None) -> bool:
    """Whether the import machinery itself runs, not a module that it executes."""
    return frame is not None and frame.f_code.co_filename.startswith("<frozen importlib")


def heed_wish() -> None:
    """Raises what a signal asked for and no one has got yet."""
    if _wish is not None:
        raise _wish


def forget_wish() -> None:
    """The work has ended."""
    global _wish
    _wish = None
    signal.setitimer(signal.ITIMER_REAL, 0)


def heed_interrupts() -> None:
    """From now on Ctrl-C ends the work at the next report of a stage, if not at once."""
    if signal.getsignal(signal.SIGINT) is signal.default_int_handler:
        signal.signal(signal.SIGINT, ending_with(KeyboardInterrupt))
