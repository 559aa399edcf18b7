"""Commands that a signal or the memory limit ends at random moments: in order, and soon?"""

from __future__ import annotations

import itertools
import os
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from robust.kills import PRODUCTS

_WAIT_S = 90.0  # wall time after the signal; a busy machine needs some
_EARLY_S = 1.0  # while modules are imported
_MEMORY_MB = (20, 60, 120, 200, 300)
_INTERRUPTED = 130
_LOG, _MAP, _OUT = "LOG", "MAP", "OUT"
COMMANDS: dict[str, tuple[str, ...]] = {
    "build": ("build", _LOG, "-o", f"{_OUT}.db", "-q", "--overwrite"),
    "fastslam": ("build", _LOG, "-o", f"{_OUT}.db", "-q", "--overwrite", "--method", "fastslam"),
    "inspect": ("inspect", "log", _LOG),
    "localise": ("localise", _MAP, _LOG, "-o", f"{_OUT}.tum"),
    "simulate": ("simulate", "apartment", "--route", "1,0", "-o", f"{_OUT}.mcap", "-q"),
    "convert": ("convert", _LOG, "-o", f"{_OUT}.mcap"),
    "report": ("export", "report", _MAP, "-o", f"{_OUT}.html"),
    "grid": ("export", "grid", _MAP, "-o", _OUT),
    "cloud": ("export", "cloud", _MAP, "-o", f"{_OUT}.ply"),
    "mesh": ("export", "mesh", _MAP, "-o", f"{_OUT}.ply"),
    "optimise": ("optimise", _MAP, "-o", f"{_OUT}.g2o"),
    "merge": ("merge", _MAP, "COPY", "-o", f"{_OUT}.db", "-q"),
    "batch": ("batch", "JOBS", "-o", f"{_OUT}.d", "-q"),
}


@dataclass
class Ends:
    """How the trials of one command ended."""

    trials: int = 0
    exits: Counter[int] = field(default_factory=Counter)
    slowest_s: float = 0.0
    """From the signal to the end, wall time."""
    faults: list[str] = field(default_factory=list)


@dataclass(frozen=True)
class Place:
    """What the commands read, and where they write."""

    log: Path
    folder: Path

    def words(self, command: Sequence[str]) -> list[str]:
        places = {
            _LOG: self.log, _MAP: self.folder / "map.db", "COPY": self.folder / "copy.db",
            "JOBS": self.folder / "jobs.toml", _OUT: self.out / "out",
        }  # fmt: skip
        found = []
        for word in command:
            for name, place in places.items():
                word = word.replace(name, str(place))
            found.append(word)
        return found

    @property
    def out(self) -> Path:
        return self.folder / "out"


def make_place(log: Path, folder: Path) -> Place:
    """With a finished map, a copy of it and a list of jobs."""
    # What a shell starts in the background ignores Ctrl-C, and all that this starts would too.
    signal.signal(signal.SIGINT, signal.default_int_handler)
    place = Place(log, folder)
    place.out.mkdir()
    build = ["build", str(log), "-o", str(folder / "map.db"), "-q"]
    _started(build, place).communicate(timeout=600.0)
    shutil.copyfile(folder / "map.db", folder / "copy.db")
    jobs = "\n".join(f'[[log]]\nname = "{n}"\nlog = "{log}"' for n in ("one", "two"))
    (folder / "jobs.toml").write_text(jobs)
    return place


def end_commands(
    place: Place, name: str, how: signal.Signals | None, count: int, seed: int
) -> Ends:
    """`count` runs of a command, ended by a signal, or by --max-memory where `how` is None."""
    found = Ends()
    words = place.words(COMMANDS[name])
    rng = np.random.default_rng((seed, list(COMMANDS).index(name)))
    lasts = 0.0 if how is None else _lasts(words, place)
    for i in range(count):
        if how is None:
            limit = str(_MEMORY_MB[i % len(_MEMORY_MB)])
            _one(found, place, [*words, "--max-memory", limit], None)
        else:
            early = rng.random() < 0.5
            after = float(rng.uniform(0.0, min(_EARLY_S, lasts) if early else lasts))
            _one(found, place, words, (after, how))
    return found


def _lasts(words: list[str], place: Place) -> float:
    """By its own clock; the builds of a batch run elsewhere, and are counted too."""
    process = _started(words, place)
    usage = os.wait4(process.pid, 0)[2]
    process.returncode = 0
    assert process.stderr is not None
    process.stderr.close()
    _emptied(place.out)
    return usage.ru_utime + usage.ru_stime


def _one(
    found: Ends, place: Place, words: list[str], end: tuple[float, signal.Signals] | None
) -> None:
    process = _started(words, place)
    reported, what = "", " ".join(words[:2])
    if end is not None:
        what += f" {end[1].name} after {end[0]:.2f} s"
        _wait_until(process, end[0], by_wall=words[0] == "batch")
        process.send_signal(end[1])
    started = time.monotonic()
    try:
        _, reported = process.communicate(timeout=_WAIT_S)
    except subprocess.TimeoutExpired:
        found.faults.append(f"{what}: hangs\n{_stacks(process.pid)}")
        os.killpg(process.pid, signal.SIGKILL)
        _, reported = process.communicate()
    found.trials += 1
    found.exits[process.returncode] += 1
    found.slowest_s = max(found.slowest_s, time.monotonic() - started)
    fault = _fault(process.returncode, reported, place, end and end[1])
    found.faults += [f"{what}: {fault}"] if fault else []
    _emptied(place.out)


def _wait_until(process: subprocess.Popen[str], after_s: float, *, by_wall: bool) -> None:
    """Until it has used so many CPU seconds, which on a busy machine say how far it is."""
    deadline = time.monotonic() + (after_s if by_wall else _WAIT_S)
    clock = (~process.pid << 3) | 2  # its clock, as clock_getcpuclockid(3) makes it
    while process.poll() is None and time.monotonic() < deadline:
        if not by_wall and time.clock_gettime(clock) >= after_s:
            return
        time.sleep(0.0005)


def _started(words: list[str], place: Place) -> subprocess.Popen[str]:
    """Its own group, as a shell gives it, and its own folder for what is written for a while."""
    (place.folder / "tmp").mkdir(exist_ok=True)
    return subprocess.Popen(
        [sys.executable, "-m", "cli.main", *words],
        stdout=subprocess.DEVNULL,
        stderr=subprocess.PIPE,
        text=True,
        start_new_session=True,
        env={**os.environ, "TMPDIR": str(place.folder / "tmp")},
    )


def _fault(code: int, reported: str, place: Place, how: signal.Signals | None) -> str:
    """What is wrong with the way it ended; empty when all is well."""
    if reported and "/cli/" not in reported and "mapmyworld" not in reported:
        return ""  # Python itself was not yet up
    ended = {0, 2, 3} if how is None else {0, 3, _INTERRUPTED, -how}
    if code not in ended:
        return f"exit code {code}: {reported[-600:]}"
    if "Traceback" in reported or "Exception ignored" in reported:
        return f"traceback: {reported[-1500:]}"
    if code in (2, _INTERRUPTED) and len(reported.strip().splitlines()) != 1:
        return f"not one line: {reported[-600:]}"
    if how is signal.SIGTERM:
        return ""  # the default: it has no time to clear up
    left = [path.name for path in (place.folder / "tmp").iterdir()]
    left += [path.name for path in place.out.iterdir() if _is_stray(path)]
    return f"left behind: {left}" if left and code != -signal.SIGINT else ""


def _is_stray(path: Path) -> bool:
    """Half a file; what a build has finished stays, and what it was writing, to go on with."""
    ours = {*PRODUCTS, ".html", ".json", ".mcap", ".g2o", ".d", ".truth", ".db-journal"}
    return not path.name.startswith("out") or not ours & set(path.suffixes)


def _emptied(folder: Path) -> None:
    for place in (folder, folder.parent / "tmp"):
        shutil.rmtree(place, ignore_errors=True)
        place.mkdir()


def _stacks(process: int) -> str:
    """Where its threads stand, if py-spy is there to look."""
    spy = shutil.which("py-spy", path=f"{Path(sys.executable).parent}{os.pathsep}{os.defpath}")
    if spy is None:
        return "(install py-spy to see where)"
    command = [spy, "dump", "--pid", str(process)]
    return subprocess.run(command, capture_output=True, text=True, timeout=60.0, check=False).stdout


def end_all(log: Path, count: int, seed: int, only: str) -> list[str]:
    """Every command by Ctrl-C and by SIGTERM, builds by the limit too; lines that indicate."""
    lines = []
    with tempfile.TemporaryDirectory(prefix="signals-") as name:
        place = make_place(log, Path(name))
        signals = (signal.SIGINT, signal.SIGTERM)
        kinds: list[tuple[str, signal.Signals | None]] = [*itertools.product(COMMANDS, signals)]
        kinds += [(c, None) for c in ("build", "fastslam")]
        for command, how in kinds:
            reported = f"{command} {how.name if how else '--max-memory'}"
            if only not in reported:
                continue
            found = end_commands(place, command, how, count, seed)
            exits = ", ".join(f"{n} x {code}" for code, n in sorted(found.exits.items()))
            line = f"{reported}: {found.trials} ended ({exits}), slowest {found.slowest_s:.1f} s"
            lines += [line, *(f"  {fault}" for fault in found.faults)]
            print("\n".join(lines[-1 - len(found.faults) :]), flush=True)
    return lines
