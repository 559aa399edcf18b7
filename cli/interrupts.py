"""Ctrl-C and the memory limit end the work in order.

A signal only notes the wish. It is raised where a stage next reports how far it is, between two
steps of our own code. Where nothing reports for a second, it is raised in the main thread wherever
that is, as Python does with Ctrl-C; should a lock be left held there and the work not end, the
process does, which maps survive.
"""

from __future__ import annotations

import os
import signal
from collections.abc import Callable
from types import FrameType

from cli.exit_codes import EXIT_INTERRUPTED

_REPORTS_WITHIN_S = 1.0
_CLEARS_UP_WITHIN_S = 20.0
_MOST_CALLS = 3  # so many times Ctrl-C: whatever the program waits for, it ends at once

_wish: type[Ending] | None = None
_raised = False
_calls = 0


class Ending(BaseException):
    """Ends the work of the main thread."""

    exit_code = EXIT_INTERRUPTED


class Interrupted(Ending):
    """Ctrl-C. Python remembers a KeyboardInterrupt that has passed through code made from text, as
    of dataclasses and named tuples, and then ends by the signal, not with our exit code.
    """


def ending_with(exception: type[Ending]) -> Callable[[int, FrameType | None], None]:
    """A signal handler that notes the wish, until `forget_wish`."""

    def note(number: int, _: FrameType | None) -> None:
        global _wish, _calls
        if _wish is None:
            _wish = exception
            signal.signal(signal.SIGALRM, _not_heeded)
            signal.setitimer(signal.ITIMER_REAL, _REPORTS_WITHIN_S)
        _calls += number == signal.SIGINT
        if _calls == _MOST_CALLS - 1:  # what runs C code gives this handler no turn
            signal.signal(signal.SIGINT, signal.SIG_DFL)

    return note


def _not_heeded(_number: int, _: FrameType | None) -> None:
    if _raised and _wish is not None:
        os.write(2, b"mapmyworld: ended at once; the same command goes on with this stage\n")
        os._exit(_wish.exit_code)
    heed_wish()


def is_wished(kind: type[Ending]) -> bool:
    """Whether it was asked for and has not been seen to: others' code may have made it an error."""
    return _wish is kind


def heed_wish() -> None:
    """Raises what a signal asked for."""
    global _raised
    if _wish is not None:
        if not _raised:
            _raised = True
            signal.setitimer(signal.ITIMER_REAL, _CLEARS_UP_WITHIN_S)
        raise _wish


def forget_wish(kind: type[Ending]) -> None:
    """The work that it was to end has ended."""
    global _wish, _raised
    if _wish is kind:
        _wish, _raised = None, False
        signal.setitimer(signal.ITIMER_REAL, 0)


def heed_interrupts() -> None:
    """From now on Ctrl-C ends the work in order."""
    global _calls
    _calls = 0
    if signal.getsignal(signal.SIGINT) in (signal.default_int_handler, signal.SIG_DFL):
        signal.signal(signal.SIGINT, ending_with(Interrupted))


def forget_interrupts() -> None:
    """The command has ended: nothing is left that would have to end in order."""
    forget_wish(Interrupted)
    if signal.getsignal(signal.SIGINT) is not signal.SIG_IGN:
        signal.signal(signal.SIGINT, signal.SIG_DFL)
