"""Progress on stderr: a bar on a terminal, a line now and then elsewhere."""

from __future__ import annotations

import sys
import time
from dataclasses import dataclass
from typing import Any

import click

from cli.interrupts import heed_wish
from cli.manners import is_verbose
from cli.memory import peak_memory_mb
from cli.standard_streams import own_words
from formats.readable import readable
from mapmyworld.heap import give_back

_LINE_EVERY_S = 15.0  # between lines of progress where there is no terminal


@dataclass(frozen=True, slots=True)
class StageCost:
    """What one stage took."""

    name: str
    wall_s: float
    cpu_s: float
    peak_memory_mb: float
    """Of the whole process up to the stage's end."""


class StderrProgress:
    """Says which stage runs, how far it is, and how much faster than the robot drove."""

    def __init__(self, *, quiet: bool = False) -> None:
        self.quiet = quiet
        self.notes: list[str] = []
        self.costs: list[StageCost] = []
        self._bar: Any = None
        self._name, self._unit = "", ""
        self._total: float | None = None
        self._started = self._last_line = time.monotonic()
        self._cpu = time.process_time()
        self._done = 0.0

    def stage(self, name: str, total: float | None = None, unit: str = "") -> None:
        heed_wish()
        self.finish()
        give_back()
        self._name, self._total, self._unit = name, total, unit
        self._started = self._last_line = time.monotonic()
        self._cpu = time.process_time()
        self._done = 0.0
        if not self.quiet and sys.stderr.isatty():
            self._open_bar()

    def update(self, done: float) -> None:
        heed_wish()
        self._done = done
        if self._bar is not None:
            self._bar.update(0, completed=done, speed=self._speed())
        elif not self.quiet and time.monotonic() - self._last_line > _LINE_EVERY_S:
            self._last_line = time.monotonic()
            share = f" {100 * done / self._total:.0f}%" if self._total else ""
            click.echo(f"{self._name}:{share} {self._speed()}{self._left()}", err=True)

    def note(self, message: str) -> None:
        if message in self.notes:
            return
        self.notes.append(message)
        if not self.quiet:
            text = f"note: {message}"
            if self._bar is not None:
                self._bar.console.print(readable(text), markup=False, highlight=False)
            else:
                click.echo(text, err=True)

    def finish(self) -> None:
        """Ends the current stage and says what it took."""
        if not self._name:
            return
        self._close_bar()
        elapsed = time.monotonic() - self._started
        cpu = time.process_time() - self._cpu
        self.costs.append(StageCost(self._name, elapsed, cpu, peak_memory_mb()))
        if not self.quiet:
            cost = f", {cpu:.1f} CPU s, {peak_memory_mb():.0f} MB" if is_verbose() else ""
            took = f"{elapsed:.1f} s{cost} {self._speed()}".rstrip()
            click.echo(f"{self._name}: {took}", err=True)
        self._name = ""

    def _speed(self) -> str:
        elapsed = max(time.monotonic() - self._started, 1e-3)
        if not self._done:
            return ""
        rate = rate_text(self._done / elapsed)
        return f"({rate}x real time)" if self._unit == "s" else f"({rate} {self._unit}/s)"

    def _left(self) -> str:
        """How long the stage will still take at this rate."""
        if not self._total or not self._done:
            return ""
        elapsed = time.monotonic() - self._started
        return f", {elapsed * max(self._total / self._done - 1.0, 0.0):.0f} s left"

    def _close_bar(self) -> None:
        if self._bar is not None:
            self._bar.stop()
            self._bar = None

    def _open_bar(self) -> None:
        from rich.console import Console
        from rich.progress import BarColumn, Progress, TextColumn, TimeRemainingColumn

        self._bar = Progress(
            TextColumn("{task.description}"),
            BarColumn(),
            TextColumn("{task.percentage:>3.0f}% {task.fields[speed]}"),
            TimeRemainingColumn(),
            console=Console(file=own_words(sys.stderr)),
            transient=True,
        )
        self._bar.start()
        self._bar.add_task(self._name, total=self._total, speed="")
        context = click.get_current_context(silent=True)
        if context is not None:  # however the command ends, what it says then has a line of its own
            context.call_on_close(self._close_bar)


def rate_text(rate: float) -> str:
    """A rate as a person says it: 0.019, 3.7, 250; never 0 for what goes on."""
    return f"{rate:.0f}" if rate >= 10 else f"{rate:.2g}"
