"""The commands of a batch: processes of the program, which end when the batch does."""

from __future__ import annotations

import ctypes
import signal
import subprocess
import sys
import threading
from collections.abc import Sequence

from cli.exit_codes import EXIT_BAD_INPUT, EXIT_CHECK_FAILED, EXIT_PARTIAL
from mapmyworld.errors import MapError

_TRIES = 2  # of a process that something killed
_ANSWERS = {0, EXIT_BAD_INPUT, EXIT_PARTIAL, EXIT_CHECK_FAILED}  # else a command did not end well
_PR_SET_PDEATHSIG = 1
_LIBC = ctypes.CDLL(None)

_running: set[subprocess.Popen[str]] = set()
_ended = False
_starting = threading.Lock()  # so that none starts unseen while they are being ended


def run_command(arguments: Sequence[str]) -> subprocess.CompletedProcess[str]:
    """What it answered; raises `MapError` where it was killed every time, crashed or was ended."""
    for _ in range(_TRIES):
        done = _run(arguments)
        if done.returncode in _ANSWERS:
            return done
        if done.returncode > 0 or _ended:
            raise MapError(why(done))
    raise MapError(
        f"the process was killed by signal {-done.returncode}, {_TRIES} times: if memory is short, "
        "give fewer --jobs at a time"
    )


def _run(arguments: Sequence[str]) -> subprocess.CompletedProcess[str]:
    with _starting:
        if _ended:
            raise MapError("the batch was interrupted")
        process = subprocess.Popen(
            [sys.executable, "-m", "cli.main", *arguments],
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            text=True,
            preexec_fn=_die_with_parent,
        )
        _running.add(process)
    try:
        out, reported = process.communicate()
    finally:
        _running.discard(process)
    return subprocess.CompletedProcess(arguments, process.returncode, out, reported)


def _die_with_parent() -> None:
    """So that a killed batch leaves no build behind that writes the maps it will go on with."""
    _LIBC.prctl(_PR_SET_PDEATHSIG, signal.SIGKILL)


def begin_commands() -> None:
    """From now on commands may start."""
    global _ended
    _ended = False


def end_commands() -> None:
    """Asks what runs to end in order, as Ctrl-C does; nothing starts until the next beginning."""
    global _ended
    with _starting:
        _ended = True
        for process in _running:
            process.send_signal(signal.SIGINT)


def why(done: subprocess.CompletedProcess[str]) -> str:
    """What a command that did not end well said of it."""
    reported = done.stderr.strip().removeprefix("mapmyworld: ")
    return reported or f"exit code {done.returncode} without a message"
