"""`mapmyworld inspect`: what is in a log, a graph, a node, a map."""

from __future__ import annotations

from pathlib import Path

import click

from cli.lazy import LazyGroup

_PARTS = {
    "log": ("cli.inspect_log:log", "What is in a log, the plan with its reasons, the diagnosis."),
    "graph": ("cli.inspect_graph:graph", "Nodes and constraints: accepted, rejected, and why."),
    "node": ("cli.inspect_node:node", "One node: pose, sigma, sensors, its constraints."),
    "map": ("cli.inspect_map:inspect_map", "Sessions, length, duration, area, quality."),
}


class _InspectGroup(LazyGroup):
    """Where a file stands in a command's place, `log` or `map` shows it."""

    def resolve_command(
        self, ctx: click.Context, args: list[str]
    ) -> tuple[str | None, click.Command | None, list[str]]:
        path = Path(args[0])
        if args[0] not in _PARTS and (path.suffix or path.exists()):
            args = ["map" if _is_map(path) else "log", *args]
        return super().resolve_command(ctx, args)


def _is_map(path: Path) -> bool:
    """Whether it is a database of nodes, of ours or of RTAB-Map's."""
    from formats.database.connection import is_sqlite
    from formats.logs.opening_logs import tables_of

    return path.is_file() and is_sqlite(path) and "Node" in tables_of(path)


@click.group(cls=_InspectGroup, table=_PARTS)
def inspect() -> None:
    """Show what is in a log, a graph, a node or a map.

    A FILE without a command is shown as the log or the map that it is.

    \b
    mapmyworld inspect drive.mcap
    mapmyworld inspect graph
    """
