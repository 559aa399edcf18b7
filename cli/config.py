"""`mapmyworld config`: every setting with its default, unit and meaning."""

from __future__ import annotations

import click

from cli.arguments import format_option
from cli.standard_streams import show_json
from mapmyworld.config.settings import as_toml, list_settings


@click.command()
@format_option
def config(style: str) -> None:
    """Print every setting as commented TOML.

    \b
    mapmyworld config > my.toml      then edit it and
    mapmyworld build log.mcap --config my.toml
    """
    if style == "json":
        show_json({s.name: {"default": s.value, "meaning": s.meaning} for s in list_settings()})
    else:
        click.echo(as_toml(), nl=False)
