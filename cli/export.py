"""`mapmyworld export`: what a map holds as files."""

from __future__ import annotations

import click

from cli import export_maps, export_nodes
from cli.arguments import format_option


@click.group()
def export() -> None:
    """Write what a map holds as files that other programs read.

    \b
    mapmyworld export grid --resolution 0.025
    mapmyworld export trajectory office.db --style kitti
    mapmyworld export cloud rtabmap.db -o office.ply       (a database of RTAB-Map's)
    """


# Every command of these modules: a new export has no other registration.
for module in (export_maps, export_nodes):
    for command in vars(module).values():
        if isinstance(command, click.Command):
            export.add_command(format_option(command))
