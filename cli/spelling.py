"""Names as half of the world spells them, and what was meant by one that there is not."""

from __future__ import annotations

import difflib
import re
from collections.abc import Collection

_BRITISH = {
    "localize": "localise",
    "optimize": "optimise",
    "optimized": "optimised",
    "neighbor": "neighbour",
}


def british(text: str) -> str:
    """The text with its words spelt as the names here are: `graph.constraints.neighbour.tried`."""
    return re.sub("[a-z]+", lambda word: _BRITISH.get(word[0], word[0]), text)


def meant(name: str, known: Collection[str]) -> str:
    """The name that was probably meant, as a question behind a full stop; empty where none is."""
    near = difflib.get_close_matches(name, known, n=1)
    return f" Did you mean {near[0]!r}?" if near else ""


def settings_named(option: str) -> list[str]:
    """Full names of the settings that an option like --resolution asks for."""
    from mapmyworld.config.settings import list_settings

    wanted = option.lstrip("-").replace("-", "_")
    tails = [(one.name.rpartition(".")[2], one.name) for one in list_settings()]
    near = difflib.get_close_matches(wanted, {tail for tail, _ in tails}, n=1, cutoff=0.8)
    return [name for tail, name in tails if tail in near]
