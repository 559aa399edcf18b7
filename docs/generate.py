"""Writes the pages that come from the program itself: `python docs/generate.py`."""

from __future__ import annotations

import sys
from collections.abc import Iterator
from pathlib import Path

import click

from cli.main import group
from mapmyworld.config.settings import list_settings

HERE = Path(__file__).parent


def messages_page() -> str:
    """Every message about bad input, with its suggestion."""
    sys.path.insert(0, str(HERE))
    from all_messages import page

    return page()


def index_page() -> str:
    """Everything that is printed or shown, by its beginning."""
    sys.path.insert(0, str(HERE))
    from message_index import index_page

    return index_page()


def commands_page() -> str:
    """Every command with its help text."""
    parts = ["# Commands", "", "Written by `python docs/generate.py`; do not edit."]
    for names, command in commands(group, ("mapmyworld",)):
        context = click.Context(
            command,
            info_name=" ".join(names),
            terminal_width=96,
            help_option_names=group.context_settings["help_option_names"],
            show_default=group.context_settings["show_default"],
        )
        parts += ["", f"## {' '.join(names)}", "", "```", command.get_help(context), "```"]
    return "\n".join(parts) + "\n"


def commands(
    command: click.Command, names: tuple[str, ...]
) -> Iterator[tuple[tuple[str, ...], click.Command]]:
    """A command with the words that call it, and those inside it."""
    yield names, command
    if isinstance(command, click.Group):
        context = click.Context(command, info_name=names[-1])
        for name in command.list_commands(context):
            inner = command.get_command(context, name)
            if inner is not None:
                yield from commands(inner, (*names, name))


def settings_page() -> str:
    """Every setting, its default and its meaning."""
    rows = ["# Settings", "", "Written by `python docs/generate.py`; do not edit.", ""]
    rows += ["| setting | default | meaning |", "| --- | --- | --- |"]
    for setting in list_settings():
        meaning = setting.meaning.replace("|", "\\|")
        rows.append(f"| `{setting.name}` | `{setting.value!r}` | {meaning} |")
    return "\n".join(rows) + "\n"


PAGES = {
    "commands.md": commands_page,
    "settings.md": settings_page,
    "troubleshooting.md": messages_page,
    "messages.md": index_page,
}

if __name__ == "__main__":
    for name, page in PAGES.items():
        (HERE / name).write_text(page(), encoding="utf-8")
