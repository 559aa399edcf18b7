"""Builds killed at random moments, and taken up again: the same bytes, no finished work again."""

from __future__ import annotations

import hashlib
import json
import os
import shutil
import signal
import sqlite3
import tempfile
import time
from collections.abc import Callable, Sequence
from contextlib import closing
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from robust.trials import end_with_parent, try_command

_WAIT_S = 120.0  # wall time in which a build ends that was reported to, on a busy machine too
PRODUCTS = (".db", ".pgm", ".yaml", ".tum", ".ply")


@dataclass
class Kills:
    """What came of killing one kind of build many times."""

    kills: int = 0
    late: int = 0
    """Kills that came after the build had ended."""
    stages_kept: int = 0
    """Stages found finished after kills; none of them may be done again."""
    repeated: list[str] = field(default_factory=list)
    different: list[str] = field(default_factory=list)
    unusable: list[str] = field(default_factory=list)
    after: dict[str, int] = field(default_factory=dict)
    """Last stage finished when the kill came -> how often."""

    @property
    def faults(self) -> list[str]:
        return [*self.repeated, *self.different, *self.unusable]


def kill_builds(
    log: Path,
    options: Sequence[str],
    count: int,
    seed: int,
    watch: Callable[[Kills], None] = print,
    how: signal.Signals = signal.SIGKILL,
) -> Kills:
    """Kills `count` builds of a log with -9, or so, takes each up again, and compares."""
    found = Kills()
    rng = np.random.default_rng(seed)
    with tempfile.TemporaryDirectory(prefix="kills-") as name:
        folder = Path(name)
        build = ["build", str(log), "-q", "--format", "json", *options, "-o"]
        try_command([*build, str(folder / "warm.db")], seconds=600.0)  # loads what is loaded late
        (folder / "whole").mkdir()
        map_path = folder / "whole" / "map.db"
        lasts = _wait(_forked([*build, str(map_path)], map_path.with_suffix(".json")))
        wanted = digests(map_path)
        for i in range(count):
            (folder / str(i)).mkdir()
            map_path = folder / str(i) / "map.db"
            _kill_one(found, map_path, build, wanted, (rng.uniform(0.0, lasts), how))
            shutil.rmtree(folder / str(i))
            if i % 10 == 9:
                watch(found)
    return found


def _kill_one(
    found: Kills,
    path: Path,
    build: list[str],
    wanted: dict[str, str],
    kill: tuple[float, signal.Signals],
) -> None:
    after_s, how = kill
    child = _forked([*build, str(path)], path.with_suffix(".json"))
    while not _ended(child) and _cpu_seconds(child) < after_s:
        time.sleep(0.0005)
    os.kill(child, how)
    if not _ends_soon(child):
        found.unusable.append(f"hangs after {how.name} at {after_s:.2f} s")
        os.kill(child, signal.SIGKILL)
    _wait(child)
    found.kills += 1
    reported = path.with_suffix(".json")
    found.late += reported.exists() and bool(reported.read_text())
    if path.exists() and path.stat().st_size:
        looked = try_command(["inspect", "map", str(path)])
        if looked.exit_code not in (0, 2) or looked.fault:
            found.unusable.append(f"killed after {after_s:.2f} s: {looked.fault or looked.stderr}")
    done = finished_stages(path)
    found.stages_kept += len(done)
    last = done[-1] if done else "nothing"
    found.after[last] = found.after.get(last, 0) + 1
    resume = ["--resume"] if path.exists() else []
    outcome = try_command([*build, str(path), *resume])
    if outcome.exit_code not in (0, 3):
        found.unusable.append(f"not resumed after {last}: {outcome.fault or outcome.stderr}")
        return
    again = set(done) - set(json.loads(outcome.stdout)["reused_stages"])
    if again:
        found.repeated.append(f"killed after {last}: {', '.join(sorted(again))} done again")
    for ending, digest in digests(path).items():
        if digest != wanted[ending]:
            found.different.append(f"killed after {last} ({after_s:.2f} s): {ending} differs")


def finished_stages(path: Path) -> list[str]:
    """Stages that a map records as done, in their order."""
    if not path.exists():
        return []
    with closing(sqlite3.connect(path)) as database:  # takes back what was half written
        try:
            rows = database.execute("SELECT stage FROM mapmyworld_stages ORDER BY rank")
            return [stage for (stage,) in rows]
        except sqlite3.OperationalError:  # killed before the tables were there
            return []


def digests(path: Path) -> dict[str, str]:
    """Ending -> SHA-256 of a build's files."""
    files = {ending: path.with_suffix(ending) for ending in PRODUCTS}
    return {
        ending: hashlib.sha256(file.read_bytes()).hexdigest() if file.exists() else "absent"
        for ending, file in files.items()
    }


def _forked(arguments: list[str], result: Path) -> int:
    """A build in a child process; `result` is written when it has ended."""
    child = os.fork()
    if child:
        return child
    try:
        end_with_parent()
        outcome = try_command(arguments, seconds=600.0)
        result.write_text(outcome.stdout)
    finally:
        os._exit(0)


def _ended(child: int) -> bool:
    return os.waitid(os.P_PID, child, os.WEXITED | os.WNOHANG | os.WNOWAIT) is not None


def _ends_soon(child: int) -> bool:
    deadline = time.monotonic() + _WAIT_S
    while not _ended(child) and time.monotonic() < deadline:
        time.sleep(0.002)
    return _ended(child)


def _cpu_seconds(child: int) -> float:
    """Of the process so far: on a busy machine it says better than a clock how far it is."""
    return time.clock_gettime((~child << 3) | 2)  # its clock, as clock_getcpuclockid(3) makes it


def _wait(child: int) -> float:
    """Waits for its end; gives the CPU seconds it took."""
    usage = os.wait4(child, 0)[2]
    return usage.ru_utime + usage.ru_stime
