"""`--debug FILE`: every decision of a command as a line, with when it was made."""

from __future__ import annotations

import logging
import platform
import shlex
import sys
from pathlib import Path

import click

import mapmyworld
from cli.outputs import require_file
from mapmyworld.decisions import LOGGER, decided
from mapmyworld.errors import MapError

_LINE = "%(relativeCreated)9.0f ms  %(topic)-9s %(message)s"  # since the program began


def _require_place(path: Path) -> None:
    """Refuses to replace anything but an earlier log of decisions."""
    require_file(path)
    if not path.exists():
        return
    with path.open("rb") as file:
        head = file.read(64)
    if head and b"command   mapmyworld" not in head:
        raise MapError(f"{path}: exists and is no log of --debug: give another name")


def keep_decisions(context: click.Context, path: Path) -> None:
    """Writes the decisions of the command that runs into a file, until it ends; MapError where
    that is no log of --debug.
    """
    _require_place(path)
    handler = logging.FileHandler(path, mode="w", encoding="utf-8", errors="backslashreplace")
    handler.setFormatter(logging.Formatter(_LINE, defaults={"topic": "note"}))
    LOGGER.addHandler(handler)
    LOGGER.setLevel(logging.DEBUG)
    decided("command", shlex.join(["mapmyworld", *sys.argv[1:]]))
    system = f"{platform.platform()}, Python {platform.python_version()}"
    decided("command", f"mapmyworld {mapmyworld.__version__} on {system}")

    def close() -> None:
        error = sys.exception()
        if error is not None and not isinstance(error, SystemExit | click.exceptions.Exit):
            LOGGER.debug("%s", error, exc_info=error, extra={"topic": "error"})
        decided("command", "ended")
        LOGGER.removeHandler(handler)
        LOGGER.setLevel(logging.NOTSET)
        handler.close()

    context.call_on_close(close)
