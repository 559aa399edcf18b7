"""The library for notebooks and programs: a log goes in, a map comes out, nothing is printed."""

from __future__ import annotations

from dataclasses import dataclass

from mapmyworld.config import Config
from mapmyworld.config.settings import apply_settings
from mapmyworld.memory_map import MemoryMap
from mapmyworld.pipeline import BuildResult, build_map
from mapmyworld.types import LogSource, MapStore, Progress


@dataclass(frozen=True, slots=True)
class Built:
    """A map, and what building it came to."""

    map: MapStore
    """Nodes, constraints, poses and grid, by its methods of these names."""
    result: BuildResult


class Silent:
    """A `Progress` that keeps the notes and says nothing."""

    def __init__(self) -> None:
        self.notes: list[str] = []

    def stage(self, name: str, total: float | None = None, unit: str = "") -> None:
        pass

    def update(self, done: float) -> None:
        pass

    def note(self, message: str) -> None:
        self.notes.append(message)


def build(
    log: LogSource,
    *,
    into: MapStore | None = None,
    config: Config | None = None,
    progress: Progress | None = None,
    method: str = "graph",
) -> Built:
    """The map of a log, in memory unless `into` is another store, such as an open `map.db`.

    Raises `mapmyworld.errors.MapMyWorldError` where the log cannot become a map.
    """
    store = MemoryMap() if into is None else into
    result = build_map(log, store, config or Config(), progress or Silent(), method=method)
    return Built(store, result)


def configured(**changes: object) -> Config:
    """The default configuration with settings changed; a dot is written as two underscores.

    `configured(mapping__resolution=0.025)` changes `mapping.resolution`. Raises `ConfigError`.
    """
    return apply_settings(Config(), {name.replace("__", "."): v for name, v in changes.items()})
