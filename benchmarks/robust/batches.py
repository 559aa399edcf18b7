"""Batches that are broken and killed on purpose, and what must be the same afterwards."""

from __future__ import annotations

import os
import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

from formats.recording_files import LogWriter
from mapmyworld.config.settings import apply_settings
from mapmyworld.simulation import SimulationSettings, simulate

_COMPARED = {".db", ".pgm", ".yaml", ".tum", ".ply", ".json", ".txt", ".xml", ".html"}
_TIMED = {"map.html", "map.timing.json"}  # of a map: they say how long its build took
_SETTINGS = {"laser.rate": "5", "laser.beams": "181", "camera.enabled": "false"}
_ROUTES = ("1.5,0", "start:7.2,0.6,-90 6.9,-0.5 5.6,-0.7", "start:0,2.6,60 0.4,3.6 2,3.6",
           "start:4.6,-0.7,180 2.6,-0.5")  # fmt: skip


@dataclass(frozen=True, slots=True)
class Ran:
    exit_code: int
    stdout: str
    stderr: str
    cpu_s: float
    """Of the command and all that it started and waited for."""


def write_logs(folder: Path, count: int, broken: int = 3) -> Path:
    """A manifest of so many short drives in the apartment, the last ones broken each its own way.

    One broken log is no log, one is absent, one holds no sensor; then they begin again. Every
    tenth log has requirements.
    """
    lines: list[str] = []
    settings = apply_settings(SimulationSettings(), _SETTINGS)  # type: ignore[type-var]
    for number in range(count):
        path = folder / f"log_{number:02}.mcap"
        fault = number - (count - broken)
        if fault >= 0:
            _write_broken(path, fault % 3)
        elif not path.exists():
            route = _ROUTES[number % len(_ROUTES)]
            made = simulate("apartment", seed=number, route=route, laps=1, settings=settings)
            with LogWriter(path) as log:
                for topic, message, stamp in made.messages():
                    log.write(topic, message, stamp)
        required = ['require = ["nodes >= 5"]'] if number % 10 == 0 else []
        lines += ["[[log]]", f'log = "{path.name}"', *required, ""]
    manifest = folder / "logs.toml"
    manifest.write_text("\n".join(lines))
    return manifest


def _write_broken(path: Path, fault: int) -> None:
    path.unlink(missing_ok=True)
    if fault == 0:
        path.write_bytes(b"this was a log once " * 500)
    elif fault == 2:
        with LogWriter(path):
            pass


def batch_command(manifest: Path, output: Path | str, *more: str) -> list[str]:
    return [sys.executable, "-m", "cli.main", "batch", str(manifest), "-o", str(output), *more]


def run_batch(manifest: Path, output: Path | str, *more: str) -> Ran:
    """The batch to its end."""
    before = os.times()
    done = subprocess.run(
        batch_command(manifest, output, *more), capture_output=True, text=True, check=False
    )
    after = os.times()
    cpu_s = after.children_user + after.children_system
    cpu_s -= before.children_user + before.children_system
    return Ran(done.returncode, done.stdout, done.stderr, cpu_s)


def kill_batch(manifest: Path, output: Path, build_at: int, batch_at: int, *more: str) -> int:
    """Kills a build once `build_at` logs are done, and the whole batch once `batch_at` are.

    Both with -9; says how many builds were left running by the dead batch.
    """
    shutil.rmtree(output, ignore_errors=True)
    nothing = subprocess.DEVNULL
    batch = subprocess.Popen(
        batch_command(manifest, output, *more, "-q"), stdout=nothing, stderr=nothing
    )

    def done(count: int) -> Callable[[], bool]:
        return lambda: len(list(output.glob("*/result.json"))) >= count

    _wait_for(batch, done(build_at))
    _wait_for(batch, lambda: bool(_children(batch.pid)))
    os.kill(_children(batch.pid)[0], signal.SIGKILL)
    _wait_for(batch, done(batch_at))
    _wait_for(batch, lambda: bool(_children(batch.pid)))
    builds = _children(batch.pid)
    batch.kill()
    batch.wait(timeout=60)
    deadline = time.monotonic() + 10.0  # a busy machine takes its time to end a process
    while any(map(_is_running, builds)) and time.monotonic() < deadline:
        time.sleep(0.05)
    return sum(map(_is_running, builds))


def _wait_for(batch: subprocess.Popen[bytes], ready: Callable[[], bool]) -> None:
    deadline = time.monotonic() + 300.0
    while not ready():
        if batch.poll() is not None or time.monotonic() > deadline:
            batch.kill()
            raise RuntimeError("the batch ended, or stood still, before it could be killed")
        time.sleep(0.02)


def _children(pid: int) -> list[int]:
    found: list[int] = []
    for task in Path(f"/proc/{pid}/task").glob("*/children"):
        try:
            found += map(int, task.read_text().split())
        except OSError:  # the thread has ended
            continue
    return sorted(found)


def _is_running(pid: int) -> bool:
    try:
        return Path(f"/proc/{pid}/stat").read_text().rsplit(")", 1)[1].split()[0] != "Z"
    except OSError:
        return False


def products(folder: Path) -> dict[str, bytes]:
    """Everything in a batch's folder that must not depend on how it came about."""
    return {
        str(path.relative_to(folder)): path.read_bytes()
        for path in sorted(folder.rglob("*"))
        if path.suffix in _COMPARED and path.name not in _TIMED
    }


def differences(expected: dict[str, bytes], found: dict[str, bytes]) -> Sequence[str]:
    """Names of files that only one has, or that differ."""
    names = sorted(expected.keys() | found.keys())
    return [name for name in names if expected.get(name) != found.get(name)]
