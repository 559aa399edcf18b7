"""`mapmyworld completion`, and what the tab key offers behind --set and --require."""

from __future__ import annotations

from collections.abc import Mapping

import click
from click.shell_completion import CompletionItem, get_completion_class

from cli.arguments import british

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


def settings_from(_: click.Context, __: click.Parameter, begun: str) -> list[CompletionItem]:
    """`KEY=` of every setting that begins so, with its meaning."""
    from mapmyworld.config.settings import list_settings

    return _begun({f"{setting.name}=": setting.meaning for setting in list_settings()}, begun)


def keys_from(_: click.Context, __: click.Parameter, begun: str) -> list[CompletionItem]:
    """What can be required of a map."""
    from cli.checking import KEYS

    return _begun({name: key.about for name, key in KEYS.items()}, begun)


def _begun(found: Mapping[str, str], begun: str) -> list[CompletionItem]:
    """Those names with what they mean that begin so, however that is spelt."""
    return [
        CompletionItem(name, help=about or None)
        for name, about in found.items()
        if name.startswith(british(begun))
    ]
