"""`mapmyworld completion`: commands, options and files at the press of the tab key."""

from __future__ import annotations

import click
from click.shell_completion import get_completion_class

_VARIABLE = "_MAPMYWORLD_COMPLETE"
_OFFERED = "COMPREPLY+=($value)"
_NO_SPACE = "[[ $value == *= ]] && compopt -o nospace"


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
    script = kind(root, {}, "mapmyworld", _VARIABLE).source()
    if shell == "bash":  # what ends in = is only half of a word
        script = script.replace(_OFFERED, f"{_OFFERED}\n            {_NO_SPACE}")
    click.echo(script)
