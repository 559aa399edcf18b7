"""Signals that end the work in order, also where Python drops what a handler raises.

An exception raised while a library calls back from C (a compiled kernel being loaded, say) is
printed and ignored. The wish is therefore kept, and asked for again where a stage reports.
"""

from __future__ import annotations

import signal
from collections.abc import Callable
from types import FrameType

_wish: type[BaseException] | None = None


def ending_with(exception: type[BaseException]) -> Callable[[int, FrameType | None], None]:
    """A signal handler that raises, and keeps the wish until `forget_wish`."""

    def raise_it(_signal: int, _frame: FrameType | None) -> None:
        global _wish
        _wish = exception
        raise exception

    return raise_it


def heed_wish() -> None:
    """Raises what a signal asked for and no one has got yet."""
    if _wish is not None:
        raise _wish


def forget_wish() -> None:
    """The work has ended."""
    global _wish
    _wish = None


def heed_interrupts() -> None:
    """From now on Ctrl-C ends the work at the next report of a stage, if not at once."""
    if signal.getsignal(signal.SIGINT) is signal.default_int_handler:
        signal.signal(signal.SIGINT, ending_with(KeyboardInterrupt))
