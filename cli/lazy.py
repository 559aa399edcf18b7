"""A group of commands that are imported when one of them is asked for."""

from __future__ import annotations

import importlib
from collections.abc import Mapping
from typing import Any

import click

from cli.arguments import british, meant, settings_named
from cli.manners import with_manners


class LazyGroup(click.Group):
    """Commands by name: where each stands ("module:attribute"), and the line that lists it."""

    def __init__(self, *arguments: Any, table: Mapping[str, tuple[str, str]], **more: Any) -> None:
        super().__init__(*arguments, **more)
        self._table = table

    def list_commands(self, ctx: click.Context) -> list[str]:
        return list(self._table)

    def get_command(self, ctx: click.Context, cmd_name: str) -> click.Command | None:
        if cmd_name not in self._table:
            return None
        module, attribute = self._table[cmd_name][0].split(":")
        command = getattr(importlib.import_module(module), attribute)
        assert isinstance(command, click.Command)
        return with_manners(command)

    def resolve_command(
        self, ctx: click.Context, args: list[str]
    ) -> tuple[str | None, click.Command | None, list[str]]:
        name = args[0]
        if british(name) not in self._table and not (name.startswith("-") or ctx.resilient_parsing):
            ctx.fail(f"No such command {name!r}.{meant(name, self._table)}")
        return super().resolve_command(ctx, args)

    def invoke(self, ctx: click.Context) -> Any:
        """Runs the command that is named; an option that there is not may be a setting."""
        try:
            return super().invoke(ctx)
        except click.NoSuchOption as error:
            raise _setting_error(error) from None

    def format_commands(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:
        with formatter.section("Commands"):
            formatter.write_dl([(name, line) for name, (_, line) in self._table.items()])


def _setting_error(error: click.NoSuchOption) -> click.UsageError:
    """The same error, with the setting of that name where the command takes --set."""
    command = error.ctx.command if error.ctx else None
    if command is None or not any("--set" in one.opts for one in command.params):
        return error
    found = settings_named(error.option_name)
    if not found:
        return error
    ways = " or ".join(f"--set {name}=VALUE" for name in found)
    return click.UsageError(f"No such option {error.option_name!r}: give {ways}", error.ctx)
