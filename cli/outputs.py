"""Where a command may write: a file of its own, never one that it reads, nor a log."""

from __future__ import annotations

import os
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any

from mapmyworld.errors import MapError

PRODUCTS = (".pgm", ".yaml", ".ply", ".tum", ".html", ".timing.json")
"""Endings of what `build` and `merge` write beside a map."""
_RECORDED = {b"#ROSBAG": ".bag", b"\x89MCAP0": ".mcap", b"SQLite": ".db"}


def require_outputs(paths: Iterable[Path | None], inputs: Sequence[Path | None]) -> None:
    """Refuses, before any work is done, what is no file or is one of the inputs."""
    for path in filter(None, paths):
        require_file(path)
        require_apart(path, inputs)


def require_output_name(path: Path) -> None:
    """Raises `MapError` for what names nothing: an empty name, this folder, one above, the root."""
    if path.name in ("", ".."):
        raise MapError(f"{path}: is a folder: give the name of a file")


def require_file(path: Path) -> None:
    """Raises `MapError` for what cannot be the name of a file."""
    require_output_name(path)
    if path.is_dir():
        raise MapError(f"{path}: is a folder: give the name of a file")
    if path.exists() and not path.is_file():
        raise MapError(f"{path}: is a device or a pipe: give the name of a file")


def require_apart(path: Path, inputs: Sequence[Path | None]) -> None:
    """Raises `MapError` for an input as output, whatever name or link it comes by."""
    for given in filter(None, inputs):
        if _is_same(path, given):
            named = "" if str(path) == str(given) else f" the same file as {given}, which is"
            raise MapError(f"{path}: is{named} read by this command: give another name with -o")
        if _is_part(path, given) or _is_part(given, path):
            raise MapError(f"{path}: belongs to {given}, which is read: give another name with -o")


def require_map_place(path: Path, inputs: Sequence[Path], *, export: bool) -> None:
    """Raises `MapError` for a map, with what is beside it, where another file would be lost."""
    beside = [path.with_suffix(ending) for ending in PRODUCTS] if export and path.name else []
    if export:
        require_utf8(path)
    require_outputs([path, *beside], inputs)
    if any(path == other for other in beside):
        raise MapError(f"{path}: the map's own {path.suffix} goes there: give a name ending in .db")


def products_of(map_path: Path) -> list[Path]:
    """What stands beside a map, of those files that commands write there."""
    beside = [map_path.with_suffix(ending) for ending in PRODUCTS]
    return [path for path in beside if path.is_file()]


def forget_products(map_path: Path) -> None:
    """Removes what stands beside a map and shows the one that was there before."""
    for path in products_of(map_path):
        path.unlink()


def require_utf8(path: Path) -> None:
    """Raises `MapError` for a name that the grid's YAML could not hold."""
    try:
        os.fsencode(path.name).decode("utf-8")
    except UnicodeDecodeError:
        raise MapError(
            f"{path}: is no UTF-8, which its YAML must be: give another name with -o"
        ) from None


def require_no_other(path: Path) -> None:
    """Raises `MapError` rather than replace what is no map of ours."""
    from formats.database import open_store
    from formats.database.connection import says_ours

    if not path.exists() or path.stat().st_size == 0 or says_ours(path):
        return
    open_store(path, read_only=True).close()  # says what it is
    raise MapError(f"{path}: is a database of another program's: give another name with -o")


def require_no_recording(path: Path) -> None:
    """Raises `MapError` rather than replace a log or a map by a file of another kind."""
    if not path.is_file():
        return
    with path.open("rb") as file:
        head = file.read(8)
    for mark, ending in _RECORDED.items():
        if head.startswith(mark) and path.suffix != ".mcap":
            raise MapError(f"{path}: exists and is a recording ({ending}): give another name")


def require_no_other_log(path: Path, source: Path) -> None:
    """Raises `MapError` rather than replace the map of another log than that of `source`."""
    from formats.database import open_store
    from formats.database.connection import is_sqlite

    if not path.exists() or path.stat().st_size == 0:
        return
    logs: list[Any] = []
    for file in (path, source):
        logs.append(None)
        if is_sqlite(file):
            with open_store(file, read_only=True) as store:
                logs[-1] = store.get("log")
    if logs[0] is not None and logs[0] != logs[1]:
        made_of = ", ".join(logs[0]["paths"])
        raise MapError(f"{path}: is the map of a log ({made_of}): give another name with -o")


def _is_same(path: Path, given: Path) -> bool:
    try:
        return os.path.samefile(path, given)
    except OSError:
        return False  # one of them is not there


def _is_part(path: Path, folder: Path) -> bool:
    """Whether it is a file of a recorded log, or any file that is read, in the folder."""
    if not (folder.is_dir() and path.is_file()) or path.suffix not in (".db3", ".mcap", ".bag"):
        return False
    return Path(os.path.realpath(path)).is_relative_to(os.path.realpath(folder))
