"""One command on one hostile file, in this process, by the way a user starts it."""

from __future__ import annotations

import contextlib
import ctypes
import io
import signal
import sqlite3
import subprocess
import sys
import time
import traceback
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from types import FrameType

from cli.main import main

MEMORY_MB = 1024.0
SECONDS = 10.0
GOOD_EXITS = {0, 2, 3}


class HangError(BaseException):
    """A trial used up its time; no `except Exception` may swallow it."""


@dataclass(frozen=True, slots=True)
class Outcome:
    exit_code: int | None
    """None where an exception got out."""
    fault: str
    """Empty when all is well; else what went wrong, with the traceback."""
    stdout: str
    stderr: str


def try_command(arguments: list[str], seconds: float = SECONDS) -> Outcome:
    """Runs a command; a traceback, a hang, a wrong exit code or a wordy refusal is a fault."""
    out, err = io.StringIO(), io.StringIO()
    code, fault = None, ""
    try:
        quiet = contextlib.redirect_stdout(out), contextlib.redirect_stderr(err)
        with _limited(seconds), _arguments(arguments), quiet[0], quiet[1]:
            main()
    except SystemExit as end:
        code = end.code if isinstance(end.code, int) else 0
    except HangError:
        fault = f"more than {seconds:.0f} s:\n{traceback.format_exc()}"
    except BaseException:
        fault = traceback.format_exc()
    missed = code == 4 and arguments[0] == "check"  # the map lacks what is required
    if not fault and code not in GOOD_EXITS and not missed:
        fault = f"exit code {code}: {err.getvalue()[-500:]}"
    if not fault and code == 2 and not err.getvalue().startswith("mapmyworld: "):
        fault = f"refused without a message: {err.getvalue()[-500:]}"
    if not fault and ("Traceback" in err.getvalue() or "Warning: " in err.getvalue()):
        fault = err.getvalue()
    return Outcome(code, fault, out.getvalue(), err.getvalue())


def wait_for_tables(map_db: Path, build: subprocess.Popen[str]) -> None:
    """Waits until a build of its own has begun its map: SQLite makes the file, then the tables."""
    deadline = time.monotonic() + 120.0
    while build.poll() is None and not _has_tables(map_db):
        if time.monotonic() > deadline:
            raise HangError(f"no map after two minutes: {map_db}")
        time.sleep(0.01)


def _has_tables(map_db: Path) -> bool:
    """Whether they are written for good: a file alone is empty again once its writer is killed."""
    if not map_db.exists():
        return False
    try:
        with contextlib.closing(
            sqlite3.connect(f"{map_db.as_uri()}?mode=ro", uri=True)
        ) as database:
            return bool(database.execute("SELECT count(*) FROM sqlite_master").fetchone()[0])
    except sqlite3.OperationalError:
        return False


def end_with_parent() -> None:
    """A child that waits for ever is ended when the one who minds it is (Linux)."""
    if sys.platform == "linux":
        ctypes.CDLL(None).prctl(1, signal.SIGKILL)  # PR_SET_PDEATHSIG


@contextlib.contextmanager
def _limited(seconds: float) -> Iterator[None]:
    """CPU time, so that a busy machine makes no hang; a wait that never ends is seen outside."""

    def stop(_signal: int, _frame: FrameType | None) -> None:
        raise HangError

    signal.signal(signal.SIGPROF, stop)
    signal.setitimer(signal.ITIMER_PROF, seconds)
    try:
        yield
    finally:
        signal.setitimer(signal.ITIMER_PROF, 0.0)


@contextlib.contextmanager
def _arguments(arguments: list[str]) -> Iterator[None]:
    before, sys.argv = sys.argv, ["mapmyworld", *arguments]
    try:
        yield
    finally:
        sys.argv = before
