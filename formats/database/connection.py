"""SQLite under a map: how it is opened, and its errors as ours."""

from __future__ import annotations

import os
import sqlite3
from collections.abc import Iterable, Iterator, Sequence
from contextlib import contextmanager
from datetime import UTC, datetime
from pathlib import Path
from typing import Any, Self
from urllib.parse import quote
from weakref import finalize

from formats.database.schema import TABLES, TRIGGERS
from formats.stored_tables import stored_tables
from mapmyworld.errors import MapError

SQLITE_MAGIC = b"SQLite format 3\0"
IN_MEMORY = Path(":memory:")  # SQLite's own name of what no file holds
# In the header of maps of ours, which says whose they are even where other pages are torn.
APPLICATION_ID = 0x4D4D5731  # "MMW1"
Row = tuple[Any, ...]
_PAGE_SIZE = 4096
_MOVED = "SQLITE_READONLY_DBMOVED"  # its extended code, as sqlite3 names it
_EPOCH = "1970-01-01 00:00:00"
_LAST_SECOND = 253402300799  # 9999-12-31 23:59:59 UTC
_TRIGGERS = "SELECT name, sql FROM sqlite_master WHERE type = 'trigger'"


class Connection:
    """One database file. Every failure is a MapError that names the file."""

    def __init__(self, path: Path, *, writable: bool, frozen: bool = False) -> None:
        """`frozen`: read the file as it lies, whatever another program left beside it."""
        self.path = path
        self.writable = writable
        self.entered = _EPOCH
        """The text that `time_enter` gets, UTC."""
        mode = "rwc" if writable else "ro&immutable=1" if frozen else "ro"
        with self._explained():
            uri = f"{uri_of(path)}?mode={mode}"
            self._sqlite = sqlite3.connect(
                uri, uri=True, isolation_level=None, check_same_thread=False
            )
            finalize(self, self._sqlite.close)  # logs are not closed by those who read them
            self._sqlite.execute("PRAGMA trusted_schema = OFF")  # its own views call no function
            self._refuse_programs()
            if writable:
                self._prepare_writing()

    @contextmanager
    def _explained(self) -> Iterator[None]:
        """What SQLite raises within becomes a MapError that names the file."""
        try:
            yield
        except (sqlite3.Error, UnicodeDecodeError) as error:
            if getattr(error, "sqlite_errorname", "") == _MOVED:
                raise MapError(
                    f"{self.path}: was moved or removed while it was written: give the same "
                    "command again"
                ) from error
            raise MapError(f"{self.path}: {_suggestion(str(error))}") from error

    def _refuse_programs(self) -> None:
        """No map has views as tables, or triggers that are not its own: a few bytes never end."""
        query = "SELECT name FROM sqlite_master WHERE type IN ('table', 'view')"
        named = TABLES.intersection(name for (name,) in self._sqlite.execute(query))
        if names := named - stored_tables(self._sqlite):
            raise MapError(
                f"{self.path}: is not a map ({min(names)} is no table): give another file"
            )
        if self.writable:
            for name, made in self._sqlite.execute(_TRIGGERS):
                if made not in TRIGGERS:
                    raise MapError(
                        f"{self.path}: is not a map (trigger {name!r}): give another file"
                    )

    def _prepare_writing(self) -> None:
        # RTAB-Map's triggers stamp rows with the wall clock. The same log must give the same
        # bytes, so on this connection "now" is a time taken from the log.
        self._sqlite.execute("PRAGMA trusted_schema = ON")
        self._sqlite.create_function("datetime", 1, lambda _: self.entered, deterministic=False)
        self._sqlite.execute(f"PRAGMA page_size = {_PAGE_SIZE}")
        self._sqlite.execute("PRAGMA journal_mode = DELETE")
        self._sqlite.execute("PRAGMA synchronous = NORMAL")

    def set_clock(self, stamp_ns: int) -> None:
        """Rows entered from now on are stamped with this time of the log."""
        seconds = min(max(stamp_ns // 1_000_000_000, 0), _LAST_SECOND)
        moment = datetime.fromtimestamp(seconds, UTC)
        self.entered = f"{moment.year:04d}-{moment:%m-%d %H:%M:%S}"

    def rows(self, sql: str, parameters: Sequence[Any] = ()) -> list[Any]:
        """All rows of a query."""
        with self._explained():
            return self._sqlite.execute(sql, parameters).fetchall()

    def row(self, sql: str, parameters: Sequence[Any] = ()) -> Any:
        """The first row of a query; None without one."""
        with self._explained():
            return self._sqlite.execute(sql, parameters).fetchone()

    def iterate(self, sql: str, parameters: Sequence[Any] = ()) -> Iterator[Any]:
        """Rows of a query, as they are asked for."""
        with self._explained():
            cursor = self._sqlite.execute(sql, parameters)
            while (row := cursor.fetchone()) is not None:
                yield row

    def run(self, sql: str, parameters: Sequence[Any] = ()) -> None:
        """One statement; `MapError` reports a file that cannot be written."""
        with self._explained():
            self._sqlite.execute(sql, parameters)

    def run_many(self, sql: str, rows: Iterable[Sequence[Any]]) -> None:
        """One statement for each row."""
        with self._explained():
            self._sqlite.executemany(sql, rows)

    def begin(self) -> None:
        """Opens a transaction unless one is open."""
        if not self._sqlite.in_transaction:
            self.run("BEGIN IMMEDIATE")

    def commit(self) -> None:
        """Ends the transaction, where there is one."""
        if self._sqlite.in_transaction:
            self.run("COMMIT")

    def columns(self, table: str) -> frozenset[str]:
        """Names of a table's columns; none where it is absent."""
        found = self.rows("SELECT name FROM pragma_table_info(?)", (table,))
        return frozenset(name for (name,) in found)

    def close(self) -> None:
        """Gives the file back."""
        self._sqlite.close()


def uri_of(path: Path) -> str:
    """A file's name for SQLite, whatever bytes it is of."""
    return f"file:{quote(os.fsencode(path if path == IN_MEMORY else path.absolute()))}"


def _suggestion(message: str) -> str:
    """What SQLite says, and what to do about it."""
    if "locked" in message:
        return "is in use by another program: close it there and try again"
    if "utf-8" in message.lower():  # quoted at length, with the damage in it
        return "is damaged (text that is no UTF-8): build it anew, or try `sqlite3 FILE .recover`"
    if "malformed" in message or "not a database" in message:
        return f"is damaged ({message}): build it anew, or try `sqlite3 FILE .recover`"
    if "disk is full" in message or "disk I/O" in message:
        return f"cannot be written ({message}): free some space and resume"
    if "readonly" in message:
        return f"cannot be written ({message}): change its permissions or give another place"
    if "unable to open" in message:
        return f"cannot be opened ({message}): check that the folder exists and is yours"
    return message


def keeps_write_ahead_log(path: Path) -> bool:
    """Whether the file's header asks for a -wal file, which merely reading it would create."""
    return _header(path)[18:20] == b"\2\2"


def says_ours(path: Path) -> bool:
    """Whether the file's header bears our mark; raises `MapError` where it cannot be read."""
    return int.from_bytes(_header(path)[68:72], "big") == APPLICATION_ID


def is_sqlite(path: Path) -> bool:
    """Whether the file begins as SQLite files do; raises `MapError` where it cannot be read."""
    return _header(path).startswith(SQLITE_MAGIC)


def _header(path: Path) -> bytes:
    try:
        with path.open("rb") as file:
            return file.read(72)
    except OSError as error:
        raise MapError(f"{path}: cannot be read: {error.strerror or error}") from None


class Opened:
    """Closed at the end of a `with` block."""

    def __init__(self, connection: Connection) -> None:
        self._db = connection
        self.path: Path = connection.path

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def close(self) -> None:
        self._db.close()
