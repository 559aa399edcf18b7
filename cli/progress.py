"""Progress on stderr: bars on a terminal, else a line now and then; then a line a stage."""

from __future__ import annotations

import sys
import time
from dataclasses import dataclass
from typing import Any

import click

from cli.arguments import noted
from cli.interrupts import heed_memory_limit, heed_wish, peak_memory_mb
from cli.standard_streams import in_columns, own_words
from formats.readable import readable
from mapmyworld.decisions import decided

_LINE_EVERY_S = 15.0  # between lines of progress where there is no terminal


@dataclass(slots=True)
class StageCost:
    """What one stage took, all its rounds together."""

    name: str
    wall_s: float = 0.0
    cpu_s: float = 0.0
    peak_memory_mb: float = 0.0
    """Of the whole process up to the end of the last round."""
    rounds: int = 0
    done: float = 0.0
    """In `unit`s."""
    unit: str = ""

    def add(self, wall_s: float, cpu_s: float, done: float) -> None:
        """One more round."""
        self.wall_s += wall_s
        self.cpu_s += cpu_s
        self.peak_memory_mb = peak_memory_mb()
        self.rounds += 1
        self.done += done

    def reported(self, *, verbose: bool) -> tuple[str, ...]:
        """The line's columns: name, time, CPU time and memory where asked for, the rest."""
        cost = (f"{self.cpu_s:.1f} CPU s", f"{self.peak_memory_mb:.0f} MB") if verbose else ()
        rounds = f"in {self.rounds} rounds " if self.rounds > 1 else ""
        speed = _speed(self.done, self.wall_s, self.unit)
        return (f"{self.name}:", f"{self.wall_s:.1f} s", *cost, rounds + speed)


class StderrProgress:
    """Says which stage runs, how far it is, and how much faster than the robot drove.

    Where the process then holds more than `max_memory` MB, it ends the work.
    """

    def __init__(self, max_memory: int | None = None) -> None:
        self._limit_mb = max_memory
        self.quiet = bool(noted("quiet"))
        self._began = time.monotonic(), time.process_time()
        self.notes: list[str] = []
        self.costs: dict[str, StageCost] = {}
        """By name, in the order of first rounds."""
        self._ended: dict[str, StageCost] = {}  # since lines were last written
        self._live: _Live | None = None
        self._name, self._unit = "", ""
        self._total: float | None = None
        self._started = self._last_line = time.monotonic()
        self._cpu = time.process_time()
        self._done = 0.0
        context = click.get_current_context(silent=True)
        if context is not None:  # however the command ends, what it says then has a line of its own
            context.call_on_close(self._write)

    def stage(self, name: str, total: float | None = None, unit: str = "") -> None:
        heed_wish()
        heed_memory_limit(self._limit_mb)
        self.end()
        decided("stage", f"{name} of {total:g} {unit}" if total and unit else name)
        self._name, self._total, self._unit = name, total, unit
        self._started = self._last_line = time.monotonic()
        self._cpu = time.process_time()
        self._done = 0.0
        if not self.quiet and sys.stderr.isatty():
            self._live = self._live or _Live()
            self._live.show(name, total, 0.0, "")

    def update(self, done: float) -> None:
        heed_wish()
        heed_memory_limit(self._limit_mb)
        self._done = done
        if self._live is not None:
            self._live.show(self._name, self._total, done, self._state())
        elif not self.quiet and time.monotonic() - self._last_line > _LINE_EVERY_S:
            self._last_line = time.monotonic()
            click.echo(f"{self._name}: {self._state()}", err=True)

    def note(self, message: str) -> None:
        if message in self.notes:
            return
        self.notes.append(message)
        decided("note", message)
        if not self.quiet:
            text = f"note: {message}"
            if self._live is not None:
                self._live.print(text)
            else:
                click.echo(text, err=True)

    def spent(self) -> dict[str, float]:
        """Wall and CPU seconds since it was made, and the most memory that was held."""
        return {
            "wall_s": time.monotonic() - self._began[0],
            "cpu_s": time.process_time() - self._began[1],
            "peak_memory_mb": peak_memory_mb(),
        }

    def finish(self) -> None:
        """Ends the current stage, and says what the stages took, in a line each."""
        self.end()
        self._write()

    def end(self) -> None:
        """Ends the current stage; `finish` says what it took."""
        if not self._name:
            return
        took = time.monotonic() - self._started, time.process_time() - self._cpu, self._done
        for costs in (self.costs, self._ended):
            costs.setdefault(self._name, StageCost(self._name, unit=self._unit)).add(*took)
        reported = self._ended[self._name].reported(verbose=False)
        decided("stage", f"{self._name} took {took[0]:.3f} s, {took[1]:.3f} CPU s")
        if self._live is not None:
            self._live.show(self._name, 1.0, 1.0, " ".join(reported[1:]))
        self._name = ""

    def _write(self) -> None:
        """The stages that ended, in aligned columns; what was drawn meanwhile goes."""
        if self._live is not None:
            self._live.close()
            self._live = None
        rows = [cost.reported(verbose=bool(noted("verbose"))) for cost in self._ended.values()]
        self._ended = {}
        for line, row in zip(in_columns([row[:-1] for row in rows]), rows, strict=True):
            if not self.quiet:
                click.echo(f"{line}  {row[-1]}".rstrip(), err=True)

    def _state(self) -> str:
        """How far the stage is, at which rate, and how long it will still take at it."""
        elapsed = time.monotonic() - self._started
        share = left = ""
        if self._total:
            share = f"{100 * self._done / self._total:.0f}% "
            if self._done:
                left = f", {elapsed * max(self._total / self._done - 1.0, 0.0):.0f} s left"
        return f"{share}{_speed(self._done, elapsed, self._unit)}{left}"


class _Live:
    """The stages so far on a terminal, a bar each, redrawn in place."""

    def __init__(self) -> None:
        from rich.console import Console
        from rich.progress import BarColumn, Progress, TaskID, TextColumn

        self._bars = Progress(
            TextColumn("{task.description}", markup=False),
            BarColumn(),
            TextColumn("{task.fields[state]}", markup=False),
            console=Console(file=own_words(sys.stderr)),
            transient=True,
        )
        self._tasks: dict[str, TaskID] = {}
        self._bars.start()

    def show(self, name: str, total: float | None, done: float, state: str) -> None:
        """One stage's bar, and what stands beside it."""
        if name not in self._tasks:
            self._tasks[name] = self._bars.add_task(name, total=total, state=state)
        task: Any = self._tasks[name]
        self._bars.update(task, total=total, completed=done, state=state)

    def print(self, text: str) -> None:
        """A line above the bars."""
        self._bars.console.print(readable(text), markup=False, highlight=False)

    def close(self) -> None:
        """Takes the bars away."""
        self._bars.stop()


def _speed(done: float, elapsed: float, unit: str) -> str:
    if not done:
        return ""
    rate = rate_text(done / max(elapsed, 1e-3))
    return f"({rate}x real time)" if unit == "s" else f"({rate} {unit}/s)"


def rate_text(rate: float) -> str:
    """A rate as a person says it: 0.019, 3.7, 250; never 0 for what goes on."""
    return f"{rate:.0f}" if rate >= 10 else f"{rate:.2g}"
