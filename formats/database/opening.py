"""Opening a map: ours for reading and writing, RTAB-Map's for reading."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from formats.database import schema
from formats.database.connection import Connection, is_sqlite
from formats.database.foreign import RtabmapStore
from formats.database.node_rows import StorageOptions
from formats.database.results import parameters_to_text
from formats.database.store import DatabaseStore
from mapmyworld.errors import MapError

# What RTAB-Map's tools need to know of any map of ours.
_PARAMETERS = {
    "Db/TargetVersion": schema.RTABMAP_VERSION,
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
    """
    path = Path(path)
    settings = StorageOptions(**options)
    if path.is_dir():
        raise MapError(f"{path}: is a folder, not a map")
    exists = path.exists() and path.stat().st_size > 0
    if not exists:
        if not create:
            raise MapError(f"{path}: no such map (make one with `mapmyworld build LOG -o {path}`)")
        return DatabaseStore(_created(path, settings, parameters or {}), settings)
    if not is_sqlite(path):
        raise MapError(f"{path}: is not a map (no SQLite database): give another file")
    if not _is_ours(path):
        return _foreign(path, create=create)
    if create and overwrite:
        path.unlink()
        path.with_name(path.name + "-journal").unlink(missing_ok=True)
        return DatabaseStore(_created(path, settings, parameters or {}), settings)
    return DatabaseStore(Connection(path, writable=not read_only), settings)


def _is_ours(path: Path) -> bool:
    connection = Connection(path, writable=False)
    try:
        if not connection.columns("mapmyworld_format"):
            return False
        found = connection.row("SELECT MAX(version) FROM mapmyworld_format")[0]
    finally:
        connection.close()
    if found is None or found > schema.FORMAT:
        raise MapError(
            f"{path}: was written by a newer mapmyworld (format {found}): update this one"
        )
    return True


def _foreign(path: Path, *, create: bool) -> RtabmapStore:
    """A database of RTAB-Map's, for reading; refused where a map was to be written."""
    store = RtabmapStore(Connection(path, writable=False))
    if create:
        store.close()
        raise MapError(f"{path}: is a database of RTAB-Map's and is never changed: give another -o")
    return store


def _created(path: Path, options: StorageOptions, parameters: Mapping[str, str]) -> Connection:
    """A map without nodes. Admin and Info have their one row each before any node comes."""
    if not path.absolute().parent.is_dir():
        raise MapError(f"{path}: its folder does not exist")
    connection = Connection(path, writable=True)
    connection.begin()
    for statement in schema.statements():
        connection.run(statement)
    connection.run("INSERT INTO mapmyworld_format VALUES (?)", (schema.FORMAT,))
    connection.run("INSERT INTO Admin (version) VALUES (?)", (schema.RTABMAP_VERSION,))
    told = _PARAMETERS | {"Grid/CellSize": str(options.local_cell_size)} | dict(parameters)
    connection.run(
        "INSERT INTO Info (STM_size, last_sign_added, process_mem_used, database_mem_used,"
        " dictionary_size, parameters) VALUES (0, 0, 0, 0, 0, ?)",
        (parameters_to_text(told),),
    )
    connection.commit()
    return connection
