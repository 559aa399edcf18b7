"""The one family of errors. Only `cli` turns them into a line and an exit code."""

from __future__ import annotations

from collections.abc import Sequence


class MapMyWorldError(Exception):
    """Something the user can act on: says what is wrong, where, and what to do."""

    def __init__(self, message: str, *, problems: Sequence[str] = ()) -> None:
        """`problems` lists every fault found, when there is more than one."""
        super().__init__("\n".join([message, *(f"  - {problem}" for problem in problems)]))
        self.problems = tuple(problems)


class LogError(MapMyWorldError):
    """A log that cannot be read, or holds nothing a map can be made of."""


class ConfigError(MapMyWorldError):
    """A setting that does not exist, has the wrong type or an impossible value."""


class MapError(MapMyWorldError):
    """A map, graph, grid or trajectory file that cannot be used."""


class NothingToDrawError(MapError):
    """No scan of a map has a return in range."""


class GraphError(MapMyWorldError):
    """A pose graph that cannot be optimised."""


class WorldError(MapMyWorldError):
    """A simulated world, robot or route that makes no sense."""


class MissingDependencyError(MapMyWorldError):
    """An optional library, or a system package it needs, is absent."""
