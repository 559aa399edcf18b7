"""`mapmyworld completion`: commands, options and files at the press of the tab key."""

from __future__ import annotations

import click
from click.shell_completion import get_completion_class

_VARIABLE = "_MAPMYWORLD_COMPLETE"


@click.command()
@click.argument("shell", type=click.Choice(["bash", "zsh", "fish"]))
def completion(shell: str) -> None:
    """Print the script that makes SHELL complete our commands and options.

    \b
    eval "$(mapmyworld completion bash)"                      (in ~/.bashrc)
    mapmyworld completion fish > ~/.config/fish/completions/mapmyworld.fish
    """
    kind = get_completion_class(shell)
    assert kind is not None
    root = click.get_current_context().find_root().command
    click.echo(kind(root, {}, "mapmyworld", _VARIABLE).source())
