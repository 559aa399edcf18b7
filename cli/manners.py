"""-q, -v and --debug, which every command has."""

from __future__ import annotations

import time
from pathlib import Path
from typing import Any

import click

from cli.arguments import PATH

_QUIET, _VERBOSE = "mapmyworld.quiet", "mapmyworld.verbose"


def with_manners(command: click.Command) -> click.Command:
    """The command, or all of a group's, with -q, -v and --debug."""
    if isinstance(command, click.Group):
        for inner in command.commands.values():
            with_manners(inner)
        return command
    if not any("--debug" in option.opts for option in command.params):
        command.params.append(_flag("-q", "--quiet", "No progress and no notes.", _hush))
        command.params.append(_flag("-v", "--verbose", "Show time and memory per stage.", _account))
        command.params.append(_debug_option())
    return command


def note(text: str) -> None:
    """A line on stderr that -q leaves out."""
    if not is_quiet():
        click.echo(text, err=True)


def is_quiet() -> bool:
    """Whether the command that runs was given -q."""
    return _is_asked(_QUIET)


def is_verbose() -> bool:
    """Whether the command that runs was given -v."""
    return _is_asked(_VERBOSE)


def _is_asked(name: str) -> bool:
    context = click.get_current_context(silent=True)
    return context is not None and bool(context.meta.get(name))


def _flag(short: str, long: str, text: str, act: Any) -> click.Option:
    return click.Option([short, long], is_flag=True, help=text, expose_value=False, callback=act)


def _debug_option() -> click.Option:
    return click.Option(
        ["--debug"],
        type=PATH,
        metavar="FILE",
        help="Write every decision into FILE, line by line.",
        expose_value=False,
        callback=_keep_decisions,
    )


def _keep_decisions(context: click.Context, _: click.Parameter, path: Path | None) -> None:
    if path is not None and not context.resilient_parsing:
        from cli.debug_log import keep_decisions

        keep_decisions(context, path)


def _hush(context: click.Context, _: click.Parameter, asked: bool) -> None:
    context.meta[_QUIET] = asked


def _account(context: click.Context, _: click.Parameter, asked: bool) -> None:
    """At the end, time and memory on stderr."""
    context.meta[_VERBOSE] = asked
    started = time.monotonic()

    def show() -> None:
        from cli.interrupts import peak_memory_mb

        took = f"{time.monotonic() - started:.1f} s, {time.process_time():.1f} CPU s"
        click.echo(f"{context.command_path}: {took}, {peak_memory_mb():.0f} MB at most", err=True)

    if asked:
        context.call_on_close(show)
