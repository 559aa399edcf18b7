"""Every setting at its ends, through a build: what is refused and what is not may crash nothing."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

from mapmyworld.config.settings import Setting, list_settings
from robust.trials import try_command

_SECONDS = 30.0
_TEXTS = ("nan nan nan nan nan nan", "1e300 0 0 0 0 0", "../x", "\0", "1 2")


def try_ends(log: Path, folder: Path, only: str) -> tuple[int, list[str]]:
    """How many builds were tried, and their faults, of settings whose name begins so."""
    tried, faults = 0, list[str]()
    for setting in list_settings():
        for value in _ends(setting) if setting.name.startswith(only) else ():
            change = ["--set", f"{setting.name}={value}"]
            build = ["build", str(log), "-o", str(folder / "map.db"), "-q", "--overwrite"]
            found, tried = try_command([*build, *change], _SECONDS), tried + 1
            faults += [f"{change[1]}: {found.fault}"] if found.fault else []
    return tried, faults


def _ends(setting: Setting) -> Iterator[str]:
    kind = type(setting.value)
    if kind is int:
        yield from ("0", "1", "10000000000", "99999999999999999999999")
    elif kind is float:
        yield from ("0", "1e-15", "1e-3", "1e3", "1e10", "1e300", "1e-300")
    elif kind is str:
        yield from _TEXTS
