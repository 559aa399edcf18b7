"""Which tables of an SQLite file are what they seem."""

from __future__ import annotations

import sqlite3


def stored_tables(database: sqlite3.Connection) -> frozenset[str]:
    """Names of the tables whose rows stand in the file.

    A view, a table of a module's or a computed column makes rows up as they are read: a few bytes
    of them never end.
    """
    found = set[str]()
    for name, made in database.execute("SELECT name, sql FROM sqlite_master WHERE type = 'table'"):
        if str(made).upper().startswith("CREATE TABLE"):
            query = "SELECT coalesce(max(hidden), 0) FROM pragma_table_xinfo(?)"
            if not database.execute(query, (name,)).fetchone()[0]:
                found.add(str(name))
    return frozenset(found)
