"""`mapmyworld inspect`: what is in a log, a graph, a node, a map."""

from __future__ import annotations

import importlib

import click

_PARTS = {
    "log": ("cli.inspect_log:log", "What is in a log, the plan with its reasons, the diagnosis."),
    "graph": ("cli.inspect_graph:graph", "Nodes and constraints: accepted, rejected, and why."),
    "node": ("cli.inspect_node:node", "One node: pose, sigma, sensors, its constraints."),
    "map": ("cli.inspect_map:inspect_map", "Sessions, length, duration, area, quality."),
}


class _Parts(click.Group):
    """The parts of `inspect`, imported on demand."""

    def list_commands(self, ctx: click.Context) -> list[str]:
        return list(_PARTS)

    def get_command(self, ctx: click.Context, cmd_name: str) -> click.Command | None:
        if cmd_name not in _PARTS:
            return None
        module, attribute = _PARTS[cmd_name][0].split(":")
        command = getattr(importlib.import_module(module), attribute)
        assert isinstance(command, click.Command)
        return command

    def format_commands(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:
        with formatter.section("Commands"):
            formatter.write_dl([(name, line) for name, (_, line) in _PARTS.items()])


@click.group(cls=_Parts)
def inspect() -> None:
    """Show what is in a log, a graph, a node or a map.

    \b
    mapmyworld inspect log drive.mcap
    mapmyworld inspect graph
    """
