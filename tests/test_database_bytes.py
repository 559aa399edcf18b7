"""The file itself: the same bytes for the same map, whole after a kill, never a foreign one's."""

from __future__ import annotations

import os
import signal
import sqlite3
import subprocess
import sys
import threading
from contextlib import closing
from pathlib import Path

import numpy as np
import pytest
import rtabmap_decoder as decode
from database_samples import fill, node, sample_constraints, sample_poses, scan

from formats.database import open_store
from mapmyworld.errors import MapError
from mapmyworld.types import NodeData

# Writes nodes for ever, indicating on stdout how many.
WRITER = """
import sys
import threading
sys.path.insert(0, {tests!r})
from database_samples import node, scan
from formats.database import open_store
from mapmyworld.types import NodeData
with open_store({path!r}, create=True) as store, store.write_stage("track", "t"):
    number = 0
    while True:
        number += 1
        store.add_scan(number, scan(1))
        store.add_node(node(number), NodeData(scan=scan(1)))
        print(number, flush=True)
"""


def test_the_same_map_gives_the_same_bytes(tmp_path: Path) -> None:
    for name in ("a.db", "b.db"):
        with open_store(tmp_path / name, create=True) as store:
            fill(store)
    assert (tmp_path / "a.db").read_bytes() == (tmp_path / "b.db").read_bytes()


def test_an_interrupted_and_resumed_build_gives_the_same_bytes(tmp_path: Path) -> None:
    def interrupted(path: Path) -> None:
        with open_store(path, create=True) as store, store.write_stage("track", "t"):
            store.add_node(node(1), NodeData(scan=scan(1)))
            store.add_scan(0, scan(1))
            raise KeyboardInterrupt

    with open_store(tmp_path / "a.db", create=True) as store:
        fill(store)
    with pytest.raises(KeyboardInterrupt):
        interrupted(tmp_path / "b.db")
    with open_store(tmp_path / "b.db", create=True) as store:
        fill(store)
    assert (tmp_path / "a.db").read_bytes() == (tmp_path / "b.db").read_bytes()


def test_a_stage_done_again_gives_the_same_bytes(tmp_path: Path) -> None:
    for name in ("a.db", "b.db"):
        with open_store(tmp_path / name, create=True) as store:
            fill(store)
            if name == "b.db":
                with store.write_stage("optimise", "o"):
                    store.set_poses(sample_poses())
                with store.write_stage("judge", "j"):
                    store.judge(sample_constraints())
                with store.write_stage("map", "m"):
                    pass
            else:
                with store.write_stage("map", "m"):
                    pass
    assert (tmp_path / "a.db").read_bytes() == (tmp_path / "b.db").read_bytes()


def test_a_build_with_nothing_to_do_changes_no_byte(tmp_path: Path) -> None:
    path, reported = tmp_path / "map.db", {"Kp/MaxFeatures": "600"}
    with open_store(path, create=True, parameters=reported) as store:
        fill(store)
        store.put("versions", {"numpy": "2"})
    before = path.read_bytes()
    with open_store(path, create=True, parameters=reported) as store:
        assert store.stage_done("map", "m")
        store.put("versions", {"numpy": "2"})
    assert path.read_bytes() == before


def test_a_killed_build_leaves_its_nodes(tmp_path: Path) -> None:
    """SIGKILL in the middle of a batch: the batches before it are there and whole."""
    path = tmp_path / "map.db"
    code = WRITER.format(tests=str(Path(__file__).parent), path=str(path))
    writer = subprocess.Popen([sys.executable, "-c", code], stdout=subprocess.PIPE)
    assert writer.stdout is not None
    late = threading.Timer(120.0, writer.kill)
    late.start()
    for line in writer.stdout:
        if int(line) >= 450:
            break
    late.cancel()
    writer.send_signal(signal.SIGKILL)
    writer.wait(timeout=60)
    writer.stdout.close()
    with open_store(path, read_only=True) as store:
        nodes = store.nodes()
        assert len(nodes) >= 400
        assert [n.id for n in nodes] == list(range(1, len(nodes) + 1))
        assert not store.stage_done("track", "t")
        np.testing.assert_allclose(
            store.node_data(nodes[-1].id).scan.points, scan(1).points, atol=1e-6
        )
        assert len(list(store.scans(range(1, 401)))) == 400
    decoder = decode.Decoder(path)
    assert len(decoder.rows("Node")) == len(nodes)
    assert decoder.sqlite.execute("PRAGMA integrity_check").fetchone()[0] == "ok"
    decoder.close()


def test_what_is_not_ours_is_not_overwritten(tmp_path: Path, data: Path) -> None:
    log = tmp_path / "log.bag"
    log.write_bytes(b"#ROSBAG V2.0\n" + bytes(100))
    foreign = tmp_path / "rtabmap.db"
    foreign.write_bytes((data / "rtabmap/fr079_laser.db").read_bytes())
    for path, words in ((log, "not a map"), (foreign, "never changed")):
        before = path.read_bytes()
        with pytest.raises(MapError, match=words):
            open_store(path, create=True, overwrite=True)
        assert path.read_bytes() == before


def test_a_foreign_database_is_not_touched_by_reading(tmp_path: Path, data: Path) -> None:
    path = tmp_path / "rtabmap.db"
    path.write_bytes((data / "rtabmap/fr079_laser.db").read_bytes())
    before = path.read_bytes()
    with open_store(path) as store:
        store.nodes()
        store.node_data(20)
        with pytest.raises(MapError, match="never changed"):
            store.put("key", 1)
    assert path.read_bytes() == before
    assert os.listdir(tmp_path) == ["rtabmap.db"]


def test_a_foreign_database_in_wal_mode_is_not_touched(tmp_path: Path, data: Path) -> None:
    path = tmp_path / "rtabmap.db"
    path.write_bytes((data / "rtabmap/fr079_laser.db").read_bytes())
    sqlite = sqlite3.connect(path)
    sqlite.execute("PRAGMA journal_mode = WAL")
    sqlite.close()
    before = path.read_bytes()
    with open_store(path) as store:
        assert len(store.nodes()) == 252
    assert path.read_bytes() == before
    assert os.listdir(tmp_path) == ["rtabmap.db"]


def test_a_foreign_database_left_unclean_is_refused(tmp_path: Path, data: Path) -> None:
    path = tmp_path / "rtabmap.db"
    path.write_bytes((data / "rtabmap/fr079_laser.db").read_bytes())
    (tmp_path / "rtabmap.db-journal").write_bytes(b"something")
    with pytest.raises(MapError, match="not closed cleanly"):
        open_store(path)


def test_overwriting_starts_anew(tmp_path: Path) -> None:
    with open_store(tmp_path / "map.db", create=True) as store:
        fill(store)
    with open_store(tmp_path / "map.db", create=True, overwrite=True) as store:
        assert store.nodes() == ()
        assert not store.stage_done("plan", "p")


def test_reading_only_refuses_changes(tmp_path: Path) -> None:
    with open_store(tmp_path / "map.db", create=True) as store:
        fill(store)
    with open_store(tmp_path / "map.db", read_only=True) as store:
        assert len(store.nodes()) == 3
        with pytest.raises(MapError, match="for reading only"):
            store.put("key", 1)


def problems_of_opening(path: Path) -> str:
    with pytest.raises(MapError) as caught:
        open_store(path)
    assert "\n" not in str(caught.value)
    return str(caught.value)


def test_files_that_are_no_maps_are_refused_in_one_line(tmp_path: Path) -> None:
    assert "no such map" in problems_of_opening(tmp_path / "absent.db")
    (tmp_path / "text.db").write_text("hello")
    assert "not a map" in problems_of_opening(tmp_path / "text.db")
    assert "folder" in problems_of_opening(tmp_path)
    (tmp_path / "cut.db").write_bytes(b"SQLite format 3\0" + b"\1" * 500)
    assert "damaged" in problems_of_opening(tmp_path / "cut.db")
    with closing(sqlite3.connect(tmp_path / "other.db")) as sqlite, sqlite:
        sqlite.execute("CREATE TABLE songs (title TEXT)")
    assert "neither a map nor RTAB-Map's" in problems_of_opening(tmp_path / "other.db")
    with pytest.raises(MapError, match="folder does not exist"):
        open_store(tmp_path / "no" / "map.db", create=True)


def test_a_map_of_a_later_version_is_refused(tmp_path: Path) -> None:
    with open_store(tmp_path / "map.db", create=True) as store:
        fill(store)
    with closing(sqlite3.connect(tmp_path / "map.db")) as sqlite, sqlite:
        sqlite.execute("UPDATE mapmyworld_format SET version = 99")
    assert "newer mapmyworld" in problems_of_opening(tmp_path / "map.db")


def test_questions_about_the_graph_read_no_blob_of_a_node(tmp_path: Path) -> None:
    """A damaged image must not be noticed by what does not ask for it; nor its table be scanned."""
    path = tmp_path / "map.db"
    with open_store(path, create=True) as store:
        fill(store)
    with closing(sqlite3.connect(path)) as sqlite, sqlite:
        sqlite.execute("DROP TABLE Data")
    with open_store(path, read_only=True) as store:
        assert len(store.nodes()) == 3
        assert len(store.constraints()) == 8
        assert store.poses() is not None
        assert store.grid() is not None
        assert len(list(store.scans(range(6)))) == 6
    sqlite.close()


def test_one_nodes_data_are_found_by_key(tmp_path: Path) -> None:
    with open_store(tmp_path / "map.db", create=True) as store:
        fill(store)
    sqlite = sqlite3.connect(tmp_path / "map.db")
    for query, index in (
        ("SELECT image FROM Data WHERE id = 1", "INTEGER PRIMARY KEY"),
        ("SELECT pos_x FROM Feature WHERE node_id = 1 ORDER BY rowid", "IDX_Feature_node_id"),
        ("SELECT scan FROM mapmyworld_scans WHERE frame BETWEEN 1 AND 2 ORDER BY frame", "PRIMARY"),
    ):
        plan = [row[3] for row in sqlite.execute(f"EXPLAIN QUERY PLAN {query}")]
        assert len(plan) == 1  # no sorting
        assert plan[0].startswith("SEARCH")
        assert index in plan[0]
    sqlite.close()


def test_a_map_of_an_earlier_format_is_refused_unless_it_is_replaced(tmp_path: Path) -> None:
    path = tmp_path / "map.db"
    with open_store(path, create=True) as store:
        fill(store)
    with closing(sqlite3.connect(path)) as sqlite, sqlite:
        sqlite.execute("UPDATE mapmyworld_format SET version = 1")
    assert "older mapmyworld (format 1, this one reads 5): build it anew" in problems_of_opening(
        path
    )
    with open_store(path, create=True, overwrite=True) as store:
        assert store.nodes() == ()
