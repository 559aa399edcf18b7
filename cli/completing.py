"""What the tab key offers behind --set and --require."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import click
from click.shell_completion import CompletionItem

from cli.arguments import default_map
from cli.spelling import british
from mapmyworld.errors import MapMyWorldError

if TYPE_CHECKING:
    from collections.abc import Mapping


def settings_from(_: click.Context, __: click.Parameter, begun: str) -> list[CompletionItem]:
    """`KEY=` of every setting that begins so, with its meaning."""
    from mapmyworld.config.settings import list_settings

    return [
        CompletionItem(f"{setting.name}=", help=setting.meaning)
        for setting in list_settings()
        if setting.name.startswith(british(begun))
    ]


def keys_from(context: click.Context, _: click.Parameter, begun: str) -> list[CompletionItem]:
    """What can be required of a map; once a dot is typed, the figures of the one that is there."""
    found: Mapping[str, str]
    if "." in begun:
        found = dict.fromkeys(_figures(context.params.get("map_path") or default_map()), "")
    else:
        from cli.checking import KEYS

        found = {name: key.about for name, key in KEYS.items()}
    return [
        CompletionItem(name, help=about or None)
        for name, about in found.items()
        if name.startswith(british(begun))
    ]


def _figures(path: Path) -> list[str]:
    """Names; none of what is no map: the tab key has nothing to report about it."""
    from cli.figure_names import figures_of
    from formats.database import open_store

    try:
        with open_store(path, read_only=True) as store:
            return list(figures_of(store))
    except (MapMyWorldError, OSError):
        return []
