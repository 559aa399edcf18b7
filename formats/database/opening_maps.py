"""Opening a map: ours for reading and writing, RTAB-Map's for reading."""

from __future__ import annotations

from collections.abc import Mapping
from contextlib import closing
from pathlib import Path
from typing import Any

from formats.database import schema
from formats.database.connection import (
    APPLICATION_ID,
    IN_MEMORY,
    Connection,
    is_sqlite,
    keeps_write_ahead_log,
    says_ours,
)
from formats.database.foreign import RtabmapStore
from formats.database.node_rows import StorageOptions
from formats.database.results import parameters_to_text, write_parameters
from formats.database.store import DatabaseStore
from mapmyworld.errors import MapError

# What RTAB-Map's tools need to know of any map of ours.
_PARAMETERS = {
    "Mem/IncrementalMemory": "true",
    "RGBD/CreateOccupancyGrid": "true",
    "RGBD/Enabled": "true",
}


def open_store(
    path: Path | str,
    *,
    create: bool = False,
    overwrite: bool = False,
    read_only: bool = False,
    parameters: Mapping[str, str] | None = None,
    **options: Any,
) -> DatabaseStore | RtabmapStore:
    """The map in `path`.

    `create` makes the file where there is none; `overwrite` then replaces one of ours.
    `parameters`: how the map is made, in RTAB-Map's names, for a new file.
    `options`: the fields of `StorageOptions`. A database of RTAB-Map's is never changed.

    Raises `MapError` where there is no map, or it cannot be used as asked.
    """
    path = Path(path)
    settings = StorageOptions(**options)
    if path.is_dir():
        raise MapError(f"{path}: is a folder, not a map")
    if path.is_file() and says_ours(path) and _beside(path, "journal").exists():
        # Before anything else is read: SQLite takes back what a killed build had half written.
        Connection(path, writable=True).close()
    exists = path.exists() and path.stat().st_size > 0
    if not exists and not create:
        raise MapError(f"{path}: no such map (make one with `mapmyworld build LOG -o {path}`)")
    if exists and not is_sqlite(path):
        raise MapError(f"{path}: is not a map (no SQLite database): give another file")
    if exists and not _is_ours(path, replaced=create and overwrite):
        return _foreign(path, create=create)
    if exists and create and overwrite:
        path.unlink()
        _beside(path, "journal").unlink(missing_ok=True)
        exists = False
    connection = Connection(path, writable=not read_only) if exists else _created(path)
    store = DatabaseStore(connection, settings)
    if parameters and connection.writable:
        connection.begin()
        write_parameters(connection, parameters)
        connection.commit()
    return store


class MemoryMap(DatabaseStore):
    """A map in memory: everything that `map.db` keeps, until nobody holds it any more."""

    def __init__(self) -> None:
        super().__init__(_created(IN_MEMORY), StorageOptions())

    def close(self) -> None:
        pass


def _beside(path: Path, ending: str) -> Path:
    return path.with_name(f"{path.name}-{ending}")


def _is_ours(path: Path, *, replaced: bool) -> bool:
    """Whether it is a map of ours; of a format that is read here, unless it will be `replaced`."""
    with closing(Connection(path, writable=False, frozen=True)) as connection:
        if not connection.columns("mapmyworld_format"):
            return False
        found = connection.row("SELECT MAX(version) FROM mapmyworld_format")[0]
    if not isinstance(found, int):
        raise MapError(f"{path}: the number of its format is damaged: build it anew")
    if found > schema.FORMAT:
        raise MapError(
            f"{path}: was written by a newer mapmyworld (format {found}): update this one"
        )
    if found < schema.FORMAT and not replaced:
        raise MapError(
            f"{path}: was written by an older mapmyworld (format {found}, this one reads "
            f"{schema.FORMAT}): build it anew with --overwrite"
        )
    return True


def _foreign(path: Path, *, create: bool) -> RtabmapStore:
    """A database of RTAB-Map's, for reading; refused where a map was to be written."""
    for ending in ("journal", "wal"):
        if _beside(path, ending).exists() and _beside(path, ending).stat().st_size:
            raise MapError(
                f"{path}: was not closed cleanly ({_beside(path, ending).name} lies beside it):"
                " run `rtabmap-info` on it once, or on a copy of both files"
            )
    store = RtabmapStore(Connection(path, writable=False, frozen=keeps_write_ahead_log(path)))
    if create:
        store.close()
        raise MapError(f"{path}: is a database of RTAB-Map's and is never changed: give another -o")
    return store


def _created(path: Path) -> Connection:
    """A map without nodes. Admin and Info have their one row each before any node comes."""
    if not path.absolute().parent.is_dir():
        raise MapError(f"{path}: its folder does not exist")
    connection = Connection(path, writable=True)
    connection.begin()
    connection.run(f"PRAGMA application_id = {APPLICATION_ID}")
    for statement in schema.statements():
        connection.run(statement)
    connection.run("INSERT INTO mapmyworld_format VALUES (?)", (schema.FORMAT,))
    connection.run("INSERT INTO Admin (version) VALUES (?)", (schema.RTABMAP_VERSION,))
    connection.run(
        "INSERT INTO Info (STM_size, last_sign_added, process_mem_used, database_mem_used,"
        " dictionary_size, parameters) VALUES (0, 0, 0, 0, 0, ?)",
        (parameters_to_text(_PARAMETERS),),
    )
    connection.commit()
    return connection
