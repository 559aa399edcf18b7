"""Which reader a path needs, recognised by its first bytes rather than by its name."""

from __future__ import annotations

import io
import re
from collections.abc import Callable, Sequence, Set
from contextlib import closing
from dataclasses import dataclass
from pathlib import Path
from typing import cast

from formats.logs.carmen import MARKS, CarmenLog
from formats.logs.files import DECOMPRESSION_ERRORS, UnpackedFile, begins_about_as, open_binary
from formats.logs.mcap_file import McapFile
from formats.logs.mcap_records import MAGIC as MCAP_MAGIC
from formats.logs.merged import MergedLog
from formats.logs.one_session import require_one_session
from formats.logs.ros1_bag import Ros1Bag
from formats.logs.rosbag2 import (
    SQLITE_ERRORS,
    ZSTD_MAGIC,
    SqliteBag,
    connect_read_only,
    listed_files,
    one_line,
)
from formats.logs.tum_rgbd import LISTS, TumRgbdLog
from formats.stored_tables import stored_tables
from mapmyworld.errors import LogError
from mapmyworld.types import LogSource

_HEAD = 1 << 16  # bytes that show what a file is
_PACKED = ("", ".bz2", ".gz")  # after the ending of a text log


@dataclass(frozen=True, slots=True)
class _Reader:
    """A kind of log: a file, or a folder."""

    says: str
    """In messages: what to give."""
    fits: Callable[[bytes, Path], bool]
    """Whether a file's first bytes, and its path, are those of one; the path of a folder."""
    opener: Callable[[Path], LogSource]
    endings: tuple[str, ...] = ()
    """By these a file in a folder is found: as a part of the log, or as one of its own (`batch`);
    none of a folder."""
    is_text: bool = False
    """Others use its endings too, so its first bytes must fit as well; it may be packed."""

    def names(self, path: Path) -> bool:
        """Whether a file in a folder is one by its name, and a text by its first bytes."""
        if not self.is_text:
            return path.name.endswith(self.endings)
        endings = tuple(ending + packed for ending in self.endings for packed in _PACKED)
        if not (path.name.endswith(endings) and path.is_file()):
            return False
        try:
            return self.fits(_first_bytes(path), path)
        except LogError:
            return False


def open_log(paths: Sequence[Path | str]) -> LogSource:
    """The log in these files or folders; several of them are one log in time order.

    Raises LogError with what is wrong and what to do.
    """
    if isinstance(paths, str | Path):
        paths = [paths]
    if not paths:
        raise LogError("no log given: name " + _kinds())
    sources = [_open_one(Path(path)) for path in paths]
    if len(sources) == 1:
        return sources[0]
    require_one_session(sources)
    return MergedLog(sources)


def logs_in(folder: Path) -> list[tuple[Path, ...]]:
    """The logs in a folder, by name; the numbered parts of a split recording are one.

    The folder itself, where it is one.
    """
    if _is_log_folder(folder):
        return [(folder,)]
    parts: dict[str, list[Path]] = {}
    for path in sorted(folder.iterdir(), key=_numbered):
        if _is_log_folder(path) or _is_log_file(path):
            split = _PART.fullmatch(path.name)
            whole = f"{split[1]}{split[3]}" if split else ""
            if split and int(split[2]) == len(parts.get(whole, ())):
                parts.setdefault(whole, []).append(path)
            else:
                parts[path.name] = [path]
    return [tuple(found) for found in parts.values()]


_PART = re.compile(r"(.+)_(\d+)(\..+)")


def _is_log_folder(path: Path) -> bool:
    return path.is_dir() and (
        (path / "metadata.yaml").is_file() or _reader_of(b"", path) is not None
    )


def _is_log_file(path: Path) -> bool:
    hidden = path.is_dir() or path.name.startswith(".")
    return not hidden and any(reader.names(path) for reader in _READERS)


def _open_one(path: Path) -> LogSource:
    if not path.exists():
        raise LogError(f"{path}: no such file or folder: check the path")
    if path.is_dir():
        return _open_folder(path)
    if path.name == "metadata.yaml":
        return _open_folder(path.parent)
    if not path.is_file():
        raise LogError(f"{path}: is a device or a pipe: copy what it gives into a file")
    if path.stat().st_size == 0:
        raise LogError(f"{path}: the file is empty: was the recording or the copy interrupted?")
    if reader := _reader_of(_first_bytes(path), path):
        return reader.opener(path)
    raise LogError(f"{path}: not a log this program knows: give {_kinds()}")


def _open_folder(path: Path) -> LogSource:
    if reader := _reader_of(b"", path):
        return reader.opener(path)
    metadata = path / "metadata.yaml"
    if metadata.is_file():
        listed = listed_files(metadata)
        if listed:
            more = [] if all(file.exists() for file in listed) else _recordings_in(path)
            return _open_several(path, listed, [file for file in more if file not in listed])
    if found := _recordings_in(path):
        whole = _open_several(path, found)
        if isinstance(whole, MergedLog):
            require_one_session(whole.sources)
        return whole
    raise LogError(f"{path}: no log in this folder: name " + _kinds())


def _recordings_in(folder: Path) -> list[Path]:
    return sorted((child for child in folder.iterdir() if _is_log_file(child)), key=_numbered)


def _open_several(folder: Path, files: list[Path], more: Sequence[Path] = ()) -> LogSource:
    """The parts of a split recording, as one; parts that are missing or unreadable are reported.

    `more`: files that stand beside those, where some are missing: renamed ones, read as well.
    """
    sources, problems = list[LogSource](), list[str]()
    for file in more:
        problems.append(f"{file}: is read instead of missing files that metadata.yaml names")
    for file in (*files, *more):
        try:
            sources.append(_open_one(file))
        except LogError as error:
            problems.append(str(error))
    if not sources:
        raise LogError(f"{folder}: none of its files can be read", problems=problems)
    if len(sources) == 1 and not problems:
        return sources[0]
    return MergedLog(sources, problems)


def _numbered(path: Path) -> tuple[list[str | int], str]:
    """Orders bag_2 before bag_10."""
    parts = re.split(r"(\d+)", path.name)
    return [int(part) if i % 2 else part for i, part in enumerate(parts)], path.name


def _reader_of(start: bytes, path: Path) -> _Reader | None:
    """The first that takes a file, or a folder; any other folder is looked through for files."""
    kinds = (reader for reader in _READERS if bool(reader.endings) != path.is_dir())
    return next((reader for reader in kinds if reader.fits(start, path)), None)


def _kinds() -> str:
    """All kinds of logs in a row: what to give."""
    *others, last = (reader.says for reader in _READERS)
    return f"{', '.join(others)} or {last}"


_CREATED = re.compile(rb"CREATE TABLE \"?'?(\w+)")


def _open_sqlite(path: Path) -> LogSource:
    tables = tables_of(path)
    if {"topics", "messages"} <= tables:
        return SqliteBag(UnpackedFile(path), "rosbag2 (sqlite3)")
    if "Node" in tables:
        from formats.database.log_source import open_database_log

        return open_database_log(path)
    raise LogError(f"{path}: an SQLite file that is neither a rosbag2 nor an RTAB-Map database")


def _open_packed(path: Path) -> LogSource:
    file = UnpackedFile(path)
    with file.open() as stream:
        is_mcap = stream.read(len(MCAP_MAGIC)) == MCAP_MAGIC
    if is_mcap:
        return McapFile(file, "MCAP, packed with zstd")
    return SqliteBag(file, "rosbag2 (sqlite3), packed with zstd")


def tables_of(path: Path) -> Set[str]:
    """Names of an SQLite file's tables; `LogError` where it is too damaged to determine it."""
    try:
        with closing(connect_read_only(path)) as database:
            return stored_tables(database)
    except SQLITE_ERRORS as error:
        with path.open("rb") as stream:
            named = {name.decode() for name in _CREATED.findall(stream.read(1 << 16))}
        if {"topics", "messages"} <= named or "Node" in named:  # reported where they were made
            return named
        raise LogError(f"{path}: damaged SQLite file ({one_line(error)})") from error


def _first_bytes(path: Path) -> bytes:
    """What can be had of them: a compressed file may be damaged soon after its start."""
    found = b""
    try:
        with open_binary(path) as stream:
            while len(found) < _HEAD and (block := cast(io.BufferedReader, stream).read1(4096)):
                found += block
    except DECOMPRESSION_ERRORS as error:
        if not found:
            raise LogError(f"{path}: cannot be read from the start: {error}") from error
    return found


_READERS = (
    _Reader(
        says="a rosbag2 folder/.db3, an RTAB-Map .db",
        endings=(".db3",),  # a .db beside a log is the map of it
        fits=lambda start, _: start.startswith(b"SQLite format 3\0"),
        opener=_open_sqlite,
    ),
    _Reader(
        says="a ROS 1 .bag",
        endings=(".bag",),
        fits=lambda start, _: begins_about_as(start, b"#ROSBAG V"),
        opener=lambda path: Ros1Bag(UnpackedFile(path), "ROS 1 bag"),
    ),
    _Reader(
        says="an .mcap",
        endings=(".mcap",),
        fits=lambda start, _: begins_about_as(start, MCAP_MAGIC),
        opener=lambda path: McapFile(UnpackedFile(path), "MCAP"),
    ),
    _Reader(
        says="a .db3.zstd/.mcap.zstd",  # rosbag2 compressed the file as a whole
        endings=(".db3.zstd", ".mcap.zstd"),
        fits=lambda start, path: start.startswith(ZSTD_MAGIC) and path.suffix == ".zstd",
        opener=_open_packed,
    ),
    # Last of files, because its marks may stand anywhere in the start.
    _Reader(
        says="a CARMEN .log/.clf/.gfs",
        endings=(".log", ".clf", ".gfs"),
        fits=lambda start, _: any(mark in start for mark in MARKS),
        opener=CarmenLog,
        is_text=True,
    ),
    _Reader(
        says="a TUM RGB-D folder",
        fits=lambda _, folder: any((folder / name).is_file() for name in LISTS),
        opener=TumRgbdLog,
    ),
)
