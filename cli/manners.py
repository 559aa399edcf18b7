"""-q, -v and --debug, which every command has."""

from __future__ import annotations

import time
from pathlib import Path

import click

from cli.arguments import PATH, noted, noted_option


def with_manners(command: click.Command) -> click.Command:
    """The command, or all of a group's, with -q, -v and --debug."""
    if isinstance(command, click.Group):
        for inner in command.commands.values():
            with_manners(inner)
        return command
    if not any("--debug" in option.opts for option in command.params):
        for option in (
            noted_option("-q", "--quiet", is_flag=True, help="No progress and no notes."),
            noted_option(
                "-v", "--verbose", is_flag=True, act=_account,
                help="Show time and memory per stage.",
            ),
            noted_option(
                "--debug", type=PATH, metavar="FILE", act=_keep_decisions,
                help="Write every decision into FILE, line by line.",
            ),
        ):  # fmt: skip
            option(command)
    return command


def note(text: str) -> None:
    """A line on stderr that -q leaves out."""
    if not noted("quiet"):
        click.echo(text, err=True)


def _keep_decisions(context: click.Context, path: Path) -> None:
    from cli.debug_log import keep_decisions

    keep_decisions(context, path)


def _account(context: click.Context, _: bool) -> None:
    """At the end, time and memory on stderr."""
    started = time.monotonic()

    def show() -> None:
        from cli.interrupts import peak_memory_mb

        took = f"{time.monotonic() - started:.1f} s, {time.process_time():.1f} CPU s"
        click.echo(f"{context.command_path}: {took}, {peak_memory_mb():.0f} MB at most", err=True)

    context.call_on_close(show)
