"""Builds in processes of their own; one done a second time, and compared byte by byte."""

from __future__ import annotations

import filecmp
import os
import subprocess
import sys
import tempfile
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from cli.exit_codes import EXIT_PARTIAL
from mapmyworld.errors import MapError

# What must not depend on when and how fast it was made; the page indicates the time it took.
REPEATED = {".db", ".pgm", ".yaml", ".tum", ".ply"}


def repeat_and_compare(
    logs: Sequence[Path], map_path: Path, files: Sequence[str], options: Sequence[str]
) -> None:
    """Builds again on one thread, in another folder, time zone and locale; compares `files`.

    Raises `MapError` that names the files which differ.
    """
    with tempfile.TemporaryDirectory(prefix=".repeat-", dir=map_path.absolute().parent) as name:
        again = Path(name) / map_path.name
        arguments = [*options, "--set", "threads=1", "-o", str(again)]
        arguments += [str(log.absolute()) for log in logs]
        elsewhere = {**os.environ, "TZ": "Pacific/Kiritimati", "LC_ALL": "C", "LANG": "C"}
        run_build(arguments, f"{map_path}: the second build", cwd=name, env=elsewhere)
        names = [Path(file).name for file in files if Path(file).suffix in REPEATED]
        _, differing, absent = filecmp.cmpfiles(map_path.parent, name, names, shallow=False)
    if differing := differing + absent:
        raise MapError(
            f"{map_path}: a second build gave other bytes in {', '.join(differing)}: this is a "
            "fault of mapmyworld's; please report it with the log"
        )


def run_build(arguments: Sequence[str], name: str, **where: Any) -> str:
    """What a build in a process of its own prints; `where`: its folder and environment.

    Raises `MapError` that calls it by this `name` where it gives no map.
    """
    command = [sys.executable, "-m", "cli.main", "build", "--quiet", *arguments]
    done = subprocess.run(command, capture_output=True, text=True, check=False, **where)
    if done.returncode not in (0, EXIT_PARTIAL):
        raise MapError(f"{name} failed: {done.stderr.strip() or done.returncode}")
    return str(done.stdout)
