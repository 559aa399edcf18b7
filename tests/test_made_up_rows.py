"""SQLite files whose rows are made up as they are read, without end."""

from __future__ import annotations

import sqlite3
from contextlib import closing
from pathlib import Path

import pytest
from database_samples import fill

from formats.database import open_store
from formats.logs import open_log
from formats.recording_files import LogWriter
from mapmyworld.errors import LogError, MapError
from mapmyworld.types import TextMessage

_ENDLESS = "WITH RECURSIVE r(x) AS (SELECT 1 UNION ALL SELECT x + 1 FROM r)"
_VIEWS = {
    "messages": "SELECT x AS id, 1 AS topic_id, x AS timestamp, x'00' AS data FROM r",
    "topics": "SELECT x AS id, '/t' || x AS name, 'a/msg/B' AS type,"
    " 'cdr' AS serialization_format, '' AS offered_qos_profiles FROM r",
}


@pytest.fixture
def log(tmp_path: Path) -> Path:
    with LogWriter(tmp_path / "x.db3") as writer:
        writer.write("/text", TextMessage(5, "a"), 5)
    return tmp_path / "x.db3"


@pytest.fixture
def m(tmp_path: Path) -> Path:
    with open_store(tmp_path / "m.db", create=True) as store:
        fill(store)
    return tmp_path / "m.db"


def changed(path: Path, *statements: str) -> Path:
    with closing(sqlite3.connect(path)) as database:
        database.execute("PRAGMA legacy_alter_table = ON")
        for statement in statements:
            database.execute(statement)
        database.commit()
    return path


@pytest.mark.parametrize("table", _VIEWS)
def test_a_view_is_no_table_of_a_log(log: Path, table: str) -> None:
    view = f"CREATE VIEW {table} AS {_ENDLESS} {_VIEWS[table]}"
    changed(log, f"ALTER TABLE {table} RENAME TO stored", view)
    with pytest.raises(LogError, match="neither a rosbag2"):
        open_log([log])


def test_a_computed_column_is_no_message(log: Path) -> None:
    """A gigabyte for each of its rows."""
    changed(log, "ALTER TABLE messages ADD COLUMN made AS (zeroblob(900000000))")
    with pytest.raises(LogError, match="neither a rosbag2"):
        open_log([log])


def test_views_of_other_names_disturb_nobody(log: Path) -> None:
    changed(log, f"CREATE VIEW mine AS {_ENDLESS} SELECT x FROM r")
    assert [raw.topic for raw in open_log([log]).messages()] == ["/text"]


@pytest.mark.parametrize("table", ["Node", "Link", "mapmyworld_keys", "mapmyworld_format"])
def test_a_view_is_no_table_of_a_map(m: Path, table: str) -> None:
    with closing(sqlite3.connect(m)) as database:
        columns = [row[1] for row in database.execute(f"PRAGMA table_info({table})")]
    made = ", ".join(f"x AS {name}" for name in columns)
    view = f"CREATE VIEW {table} AS {_ENDLESS} SELECT {made} FROM r"
    changed(m, f"ALTER TABLE {table} RENAME TO stored", view)
    for read_only in (True, False):
        with pytest.raises(MapError, match=f"{table} is no table"):
            open_store(m, read_only=read_only).close()


def test_a_trigger_of_another_program_is_not_set_off(m: Path) -> None:
    endless = f"SELECT count(*) FROM ({_ENDLESS} SELECT x FROM r)"
    changed(m, f"CREATE TRIGGER later AFTER INSERT ON Node BEGIN {endless}; END")
    open_store(m, read_only=True).close()
    with pytest.raises(MapError, match="trigger 'later'"):
        open_store(m)
