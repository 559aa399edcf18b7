"""A build done a second time, under other circumstances, and compared byte by byte."""

from __future__ import annotations

import filecmp
import os
import subprocess
import sys
import tempfile
from collections.abc import Sequence
from pathlib import Path

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
        command = [sys.executable, "-m", "cli.main", "build", "--quiet", *options]
        command += ["--set", "threads=1", "-o", str(again)]
        command += [str(log.absolute()) for log in logs]
        elsewhere = {**os.environ, "TZ": "Pacific/Kiritimati", "LC_ALL": "C", "LANG": "C"}
        done = subprocess.run(
            command, cwd=name, env=elsewhere, capture_output=True, text=True, check=False
        )
        if done.returncode not in (0, EXIT_PARTIAL):
            raise MapError(f"{map_path}: the second build failed: {done.stderr.strip()}")
        differing = [
            Path(file).name
            for file in files
            if Path(file).suffix in REPEATED
            and not filecmp.cmp(file, again.parent / Path(file).name, shallow=False)
        ]
    if differing:
        raise MapError(
            f"{map_path}: a second build gave other bytes in {', '.join(differing)}: this is a "
            "fault of mapmyworld's; please report it with the log"
        )
