"""`mapmyworld inspect`: what is in a log, a graph, a node, a map."""

from __future__ import annotations

import click

from cli.lazy import LazyGroup

_PARTS = {
    "log": ("cli.inspect_log:log", "What is in a log, the plan with its reasons, the diagnosis."),
    "graph": ("cli.inspect_graph:graph", "Nodes and constraints: accepted, rejected, and why."),
    "node": ("cli.inspect_node:node", "One node: pose, sigma, sensors, its constraints."),
    "map": ("cli.inspect_map:inspect_map", "Sessions, length, duration, area, quality."),
}


@click.group(cls=LazyGroup, table=_PARTS)
def inspect() -> None:
    """Show what is in a log, a graph, a node or a map.

    \b
    mapmyworld inspect log drive.mcap
    mapmyworld inspect graph
    """
