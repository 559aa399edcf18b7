"""The disk fills at the k-th write of a build, for every k: what is left, and does it go on?"""

from __future__ import annotations

import ctypes
import json
import os
import pickle
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path

from robust.kills import digests
from robust.trials import Outcome, end_with_parent, try_command

_SOURCE = Path(__file__).with_name("faulty_disk.c")
_BESIDE = (".html", ".timing.json")  # which report the build itself and need not repeat


@dataclass
class FullDisks:
    writes: int = 0
    """Of an undisturbed build."""
    tried: int = 0
    exits: dict[str, int] = field(default_factory=dict)
    faults: list[str] = field(default_factory=list)


def compiler() -> str | None:
    """The C compiler that makes the faulty disk; None without one."""
    return shutil.which("cc") or shutil.which("gcc")


def fill_disks(log: Path, options: Sequence[str], most: int) -> FullDisks:
    """Builds a log on disks that fill at the k-th write, for `most` k's spread over all."""
    found = compiler()
    assert found is not None
    with tempfile.TemporaryDirectory(prefix="faulty-") as name:
        library = Path(name) / "faulty_disk.so"
        subprocess.run(
            [found, "-shared", "-fPIC", "-O1", "-o", library, _SOURCE, "-ldl"], check=True
        )
        code = "import sys, robust.full_disk as f; f.inside(sys.argv[1:])"
        path = os.pathsep.join([str(_SOURCE.parent.parent), *sys.path])
        environment = {**os.environ, "LD_PRELOAD": str(library), "PYTHONPATH": path}
        result = Path(name) / "result"
        command = [sys.executable, "-c", code, str(result), str(log), str(most), *options]
        subprocess.run(command, check=True, env=environment, preexec_fn=end_with_parent)
        loaded = pickle.loads(result.read_bytes())  # our own child's
        assert isinstance(loaded, FullDisks)
        return loaded


def inside(arguments: list[str]) -> None:
    """The process in which the faulty disk is loaded: arms it in one child after another."""
    result, log, most, *options = arguments
    found = FullDisks()
    with tempfile.TemporaryDirectory(prefix="full-") as name:
        build = ["build", log, "-q", "--format", "json", *options, "-o"]
        (Path(name) / "warm").mkdir()
        try_command([*build, f"{name}/warm/map.db"], seconds=600.0)  # the children need not load
        found.writes = _in_child([*build, f"{name}/whole/map.db"], Path(name) / "whole", 1 << 40)[1]
        wanted = digests(Path(name) / "whole" / "map.db")
        step = max(1, found.writes // int(most))
        for k in range(1, found.writes + 1, step):
            _one(found, Path(name) / str(k), build, wanted, k)
            shutil.rmtree(Path(name) / str(k))
    Path(result).write_bytes(pickle.dumps(found))


def _one(found: FullDisks, folder: Path, build: list[str], wanted: dict[str, str], k: int) -> None:
    path = folder / "map.db"
    outcome, _ = _in_child([*build, str(path)], folder, k)
    found.tried += 1
    found.exits[str(outcome.exit_code)] = found.exits.get(str(outcome.exit_code), 0) + 1
    reported = outcome.stderr.strip()
    if outcome.fault or (outcome.exit_code == 2 and "\n" in reported) or outcome.exit_code == 0:
        found.faults.append(f"write {k}: exit {outcome.exit_code}: {outcome.fault or reported}")
    if path.exists():
        looked, _ = _in_child(["inspect", "map", str(path)], folder, None)
        if looked.fault or looked.exit_code not in (0, 2):
            found.faults.append(f"write {k}: the map is torn: {looked.fault or looked.stderr}")
    again, _ = _in_child([*build, str(path)], folder, None)
    if again.exit_code not in (0, 3):
        found.faults.append(f"write {k}: not resumed: {again.fault or again.stderr}")
    elif (now := digests(path)) != wanted:
        names = [ending for ending in wanted if now[ending] != wanted[ending]]
        found.faults.append(f"write {k}: {', '.join(names)} differ after resuming")
    expected = {path.with_suffix(ending).name for ending in (*wanted, *_BESIDE)}
    stray = {p.name for p in folder.iterdir()} - expected
    if stray:
        found.faults.append(f"write {k}: left behind {sorted(stray)}")


def _in_child(arguments: list[str], folder: Path, fails_from: int | None) -> tuple[Outcome, int]:
    """The command in a child whose disk fills; its outcome and how often it wrote."""
    folder.mkdir(exist_ok=True)
    reading, writing = os.pipe()
    child = os.fork()
    if child:
        os.close(writing)
        with os.fdopen(reading, "rb") as stream:
            reported = stream.read()
        os.waitpid(child, 0)
        outcome, count = pickle.loads(reported) if reported else (Outcome(None, "died", "", ""), 0)
        return outcome, count
    try:
        end_with_parent()
        disk = ctypes.CDLL(None)
        disk.faulty_arm.argtypes = [ctypes.c_long, ctypes.c_char_p]
        if fails_from is not None:
            disk.faulty_arm(fails_from, str(folder).encode())
        outcome = try_command(arguments, seconds=600.0)
        count = int(disk.faulty_count())
        disk.faulty_arm(-1, b"")
        with os.fdopen(writing, "wb") as stream:
            stream.write(pickle.dumps((outcome, count)))
    finally:
        os._exit(0)


def summary_lines(found: FullDisks) -> list[str]:
    exits = json.dumps(found.exits)
    return [
        f"{found.writes} writes in a whole build; the disk filled at {found.tried} of them: "
        f"exit codes {exits}, {len(found.faults)} faults",
        *(f"  {fault}" for fault in found.faults[:20]),
    ]
