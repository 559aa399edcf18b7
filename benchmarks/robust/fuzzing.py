"""Many hostile files from a few sound ones: which of them bring a command down?"""

from __future__ import annotations

import multiprocessing
import resource
import shutil
import tempfile
import time
from collections import Counter
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, field
from multiprocessing.connection import Connection
from pathlib import Path
from typing import NamedTuple

import numpy as np

from cli.interrupts import peak_memory_mb
from robust.mutations import mutated, spoil_database
from robust.trials import MEMORY_MB, try_command

_WAIT_S = 180.0  # wall time without a word from a worker: it hangs where no signal reaches
_ADDRESSES = 6 << 30  # bytes; what is too much is judged by MEMORY_MB
_PER_WORKER = 500  # cases, then a fresh process
_TEXT = {".log", ".txt", ".yaml", ".g2o", ".graph", ".toml", ".tum", ".relations", ".csv", ".obj"}
_DATABASES = {".db", ".db3"}


class Case(NamedTuple):
    """A sound file or folder, the command tried on its damaged copy, and the seed."""

    source: Path
    command: tuple[str, ...]
    """With FILE for the damaged copy and OUT for a place to write to."""
    seed: tuple[int, ...]
    beside: Path | None = None
    """A sound map that lies at OUT.db before the command begins."""


@dataclass
class Tally:
    cases: int = 0
    exits: Counter[str] = field(default_factory=Counter)
    faults: list[tuple[Case, str]] = field(default_factory=list)
    peak_mb: float = 0.0
    cpu_s: float = 0.0
    slowest_s: float = 0.0
    reported: int = 0
    """Faults shown to the user so far."""

    def add(self, case: Case, exit_code: int | None, fault: str, mb: float, cpu: float) -> None:
        self.cases += 1
        self.exits["fault" if fault else str(exit_code)] += 1
        if fault:
            self.faults.append((case, fault))
        self.peak_mb, self.cpu_s = max(self.peak_mb, mb), self.cpu_s + cpu
        self.slowest_s = max(self.slowest_s, cpu)


def damage(case: Case, folder: Path) -> Path:
    """A copy of the case's source with damage; of a folder, one or all of its files are hit."""
    target = folder / case.source.name
    if case.source.is_file():
        by_value = np.random.default_rng((*case.seed, 2)).random() < 0.5
        if case.source.suffix in _DATABASES and by_value:
            shutil.copyfile(case.source, target)
            spoil_database(target, case.seed)
            return target
        text = case.source.suffix in _TEXT
        target.write_bytes(mutated(case.source.read_bytes(), case.seed, text=text))
        return target
    shutil.copytree(case.source, target)
    files = sorted(path for path in target.rglob("*") if path.is_file())
    rng = np.random.default_rng((*case.seed, 1))
    for path in [files[int(i)] for i in rng.integers(len(files), size=int(rng.integers(1, 4)))]:
        if not path.exists():
            continue
        if rng.random() < 0.15:
            path.unlink()
        else:
            path.write_bytes(mutated(path.read_bytes(), case.seed, text=path.suffix in _TEXT))
    return target


def replaced(word: str, places: dict[str, str]) -> str:
    """A word of a command with the places it stands for."""
    for name, place in places.items():
        word = word.replace(name, place)
    return word


def run_case(case: Case) -> tuple[int | None, str, float, float]:
    """Exit code, fault, peak memory of the process in MB, CPU seconds."""
    with tempfile.TemporaryDirectory(prefix="robust-") as name:
        file = damage(case, Path(name))
        file = next(file.glob("*.yaml"), file) if "grid" in case.command else file
        places = {"FILE": str(file), "OUT": str(Path(name) / "out")}
        words = [replaced(word, places) for word in case.command]
        if case.beside is not None:
            shutil.copyfile(case.beside, f"{places['OUT']}.db")
        started = time.process_time()
        outcome = try_command(words)
        cpu = time.process_time() - started
        left = {path.name for path in Path(name).iterdir()} - {case.source.name}
        stray = {n for n in left if not n.startswith(("out", case.source.name))}
        fault = outcome.fault or (f"left behind {sorted(stray)}" if stray else "")
        if outcome.exit_code == 2 and "\n" in outcome.stderr.strip().split("\n  - ")[0]:
            fault = fault or f"more than one line: {outcome.stderr[-400:]}"
        mb = peak_memory_mb()
        return outcome.exit_code, fault, mb, cpu


def fuzz(cases: Iterable[Case], watch: Callable[[Tally], None] | None = None) -> Tally:
    """Runs the cases in worker processes, one at a time, so that even a crash is only a fault."""
    tally = Tally()
    waiting = list(cases)
    while waiting:
        batch, waiting = waiting[:_PER_WORKER], waiting[_PER_WORKER:]
        done = _in_worker(batch, tally)
        waiting = batch[done:] + waiting
        if watch is not None:
            watch(tally)
    return tally


def _in_worker(batch: list[Case], tally: Tally) -> int:
    ours, theirs = multiprocessing.Pipe()
    context = multiprocessing.get_context("fork")
    worker = context.Process(target=_work, args=(batch, ours, theirs), daemon=True)
    worker.start()
    theirs.close()
    for i, case in enumerate(batch):
        try:
            answer = ours.recv() if ours.poll(_WAIT_S) else None
        except EOFError:
            answer = None
        if answer is None:
            alive = worker.is_alive()
            worker.kill()
            worker.join()
            why = "hangs" if alive else f"the process died (exit {worker.exitcode})"
            tally.add(case, None, why, 0.0, 0.0)
            return i + 1
        tally.add(case, *answer)
    worker.join()
    return len(batch)


def _work(batch: list[Case], asked: Connection, answers: Connection) -> None:
    asked.close()  # so that it ends where the one who asks has been killed
    heavy = False
    resource.setrlimit(resource.RLIMIT_AS, (_ADDRESSES, _ADDRESSES))  # spares the machine
    for case in batch:
        exit_code, fault, mb, cpu = run_case(case)
        if mb > MEMORY_MB and not heavy:  # the peak of a process never falls again
            heavy, fault = True, fault or f"{mb:.0f} MB"
        answers.send((exit_code, fault, mb, cpu))
    answers.close()


def cases(
    sources: list[Path], commands: list[tuple[str, ...]], count: int, seed: int
) -> Iterator[Case]:
    """`count` cases, all sources and commands in turn."""
    for i in range(count):
        source = sources[i % len(sources)]
        yield Case(source, commands[(i // len(sources)) % len(commands)], (seed, i))
