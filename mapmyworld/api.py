"""The library for notebooks and programs: paths or values in, values out, nothing is printed.

With `exporting`, the only module of the library that knows files: a path is what everybody tries
first. Nothing below imports either of them.
"""

from __future__ import annotations

import os
from collections.abc import Iterator, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from pathlib import Path

from formats.database import MemoryMap, open_store
from formats.database.lock import only_writer
from formats.logs import open_log
from mapmyworld.config import Config
from mapmyworld.config.settings import apply_settings
from mapmyworld.errors import MapError
from mapmyworld.pipeline import BuildResult, build_map
from mapmyworld.types import LogSource, MapStore, OccupancyGrid, Progress
from mapmyworld.types.edits import Edit
from mapmyworld.types.localisation import Localisation

PathLike = str | os.PathLike[str]
open_map = open_store
_GRIDS = (".yaml", ".yml")


@dataclass(frozen=True, slots=True)
class Built:
    """A map, and what building it came to."""

    map: MapStore
    """Nodes, constraints, poses and grid, by its methods of these names."""
    result: BuildResult


@dataclass(frozen=True, slots=True)
class Merged:
    """One of the maps that sessions were joined to."""

    map: MapStore
    sessions: int
    links: int
    """Accepted constraints between different sessions."""


AnyLog = LogSource | PathLike | Sequence[PathLike]
AnyMap = MapStore | Built | Merged | PathLike


class Silent:
    """A `Progress` that keeps the notes and indicates nothing."""

    def __init__(self) -> None:
        self.notes: list[str] = []

    def stage(self, name: str, total: float | None = None, unit: str = "") -> None:
        pass

    def update(self, done: float) -> None:
        pass

    def note(self, message: str) -> None:
        self.notes.append(message)


def build(
    log: AnyLog,
    *,
    into: MapStore | PathLike | None = None,
    config: Config | None = None,
    progress: Progress | None = None,
    method: str = "graph",
) -> Built:
    """The map of a log: of its path, of the paths of its parts, or of an opened one.

    It is made in memory, or in the file or store `into`; a file is then open in `Built.map`, to
    be closed. Raises `mapmyworld.errors.MapMyWorldError` where the log cannot become a map.
    """
    store = _opened_for_writing(into)
    result = build_map(_log(log), store, config or Config(), progress or Silent(), method=method)
    return Built(store, result)


def localise(
    known: AnyMap | OccupancyGrid,
    log: AnyLog,
    *,
    config: Config | None = None,
    progress: Progress | None = None,
) -> Localisation:
    """Where the robot of a log was in a finished map or a bare grid, from an unknown start.

    A path may be a map.db or a grid's YAML. Raises `MapError` for a map without a grid.
    """
    from mapmyworld.localisation import localise_log
    from mapmyworld.stages.plan_log import plan_log

    config, progress, source = config or Config(), progress or Silent(), _log(log)
    plan = plan_log(source, config, progress)
    if isinstance(known, str | os.PathLike) and Path(known).suffix in _GRIDS:
        from formats.grid_files import read_grid

        known = read_grid(Path(known))
    if isinstance(known, OccupancyGrid):
        return localise_log(known, source, plan, config, progress)
    with opened(known) as store:
        return localise_log(store, source, plan, config, progress)


def merge(
    *maps: AnyMap, config: Config | None = None, progress: Progress | None = None
) -> tuple[Merged, ...]:
    """Finished maps joined where their sessions show the same place, in memory, the largest first.

    The maps given are not changed. Those that nothing connects come out as several. Raises
    `MapError` for fewer than two maps.
    """
    from mapmyworld.sessions import load_session_map, merge_maps

    if len(maps) < 2:
        raise MapError("give at least two maps to be merged")
    stores: list[MemoryMap] = []

    def fresh() -> MemoryMap:
        stores.append(MemoryMap())
        return stores[-1]

    with ExitStack() as stack:
        sources = [stack.enter_context(opened(given)) for given in maps]
        session_maps = [
            load_session_map(f"map {n}", source) for n, source in enumerate(sources, start=1)
        ]
        made = merge_maps(session_maps, fresh, config or Config(), progress or Silent())
    return tuple(Merged(s, m.sessions, m.links) for s, m in zip(stores, made, strict=True))


def edit(
    changed: AnyMap,
    edits: PathLike | Sequence[Edit],
    *,
    config: Config | None = None,
    progress: Progress | None = None,
) -> tuple[str, ...]:
    """Replaces the edits of a map by these, or by those of a TOML file, and solves it anew.

    Gives what the map then lacks, one line each. A map in a file is changed in that file.
    """
    from mapmyworld.stages.replay_edits import edit_map

    if isinstance(edits, str | os.PathLike):
        from formats.edit_files import read_edits

        edits = read_edits(Path(edits))
    config, progress = config or Config(), progress or Silent()
    if not isinstance(changed, str | os.PathLike):
        with opened(changed) as store:
            return edit_map(store, edits, config, progress)
    with only_writer(Path(changed)), open_store(Path(changed)) as filed:
        return edit_map(filed, edits, config, progress)


def export(finished: AnyMap, stem: PathLike, *, config: Config | None = None) -> tuple[Path, ...]:
    """Writes STEM.pgm + STEM.yaml, STEM.tum and, where there is depth, STEM.ply; their paths."""
    from mapmyworld.exporting import export_beside

    beside = Path(stem).with_name(f"{Path(stem).name}.db")
    with opened(finished) as store:
        return tuple(Path(path) for path in export_beside(store, beside, config or Config()))


def configured(**changes: object) -> Config:
    """The default configuration with settings changed; a dot is written as two underscores.

    `configured(mapping__resolution=0.025)` changes `mapping.resolution`. Raises `ConfigError`.
    """
    return apply_settings(Config(), {name.replace("__", "."): v for name, v in changes.items()})


@contextmanager
def opened(given: AnyMap) -> Iterator[MapStore]:
    """The map itself, of whatever holds it; a file is closed afterwards."""
    if isinstance(given, str | os.PathLike):
        with open_store(Path(given), read_only=True) as store:
            yield store
    else:
        yield given.map if isinstance(given, Built | Merged) else given


def _log(given: AnyLog) -> LogSource:
    if isinstance(given, str | os.PathLike):
        given = [given]
    if not isinstance(given, Sequence):
        return given
    return open_log([Path(path) for path in given])


def _opened_for_writing(into: MapStore | PathLike | None) -> MapStore:
    if into is None:
        return MemoryMap()
    return open_store(Path(into), create=True) if isinstance(into, str | os.PathLike) else into
