"""GPS fixes: from logs onto frames and nodes, through RTAB-Map's blobs and back."""

from __future__ import annotations

import sqlite3
import struct
from contextlib import closing
from pathlib import Path

import numpy as np
import pytest
from foreign_database import add_nodes, rtabmap_file
from log_builders import STORES, Make, serialised
from messages_in_memory import MemoryLog, scan_at, transform

from formats.database import open_store
from formats.database.log_source import open_database_log
from formats.logs.channels import Channel
from formats.logs.decoding import decoder_for
from mapmyworld.config import SensingConfig
from mapmyworld.errors import MapError
from mapmyworld.sensing import make_plan, read_frames, survey_log
from mapmyworld.types import GpsMessage, Message, Node, NodeData

STAMP = 1_600_000_000_123_456_789
FIX = GpsMessage(1_600_000_000_250_000_000, "", 48.0111, 7.8353, 245.5, 1.5)


def decoded(ros: int, name: str, *values: object) -> Message:
    make = Make(ros)
    full = f"sensor_msgs/msg/{name}"
    text, digest = STORES[ros].generate_msgdef(full, ros_version=ros)
    kinds = ("ros1", "ros1msg") if ros == 1 else ("cdr", "ros2msg")
    decoder = decoder_for(Channel("/t", full, *kinds, text.encode(), digest))
    message = make(full, make.header(STAMP, "mast"), *values)
    return decoder.message(serialised(ros, ("/t", full, 0, message)), 5).decode()


@pytest.mark.parametrize("ros", [1, 2])
@pytest.mark.parametrize(("kind", "error"), [(0, 10.0), (2, 3.0)])
def test_a_fix_has_the_largest_of_its_deviations(ros: int, kind: int, error: float) -> None:
    status = Make(ros)("sensor_msgs/msg/NavSatStatus", 0, 1)
    covariance = np.diag([4.0, 9.0, 1.0]).ravel()
    message = decoded(ros, "NavSatFix", status, 48.0, 7.5, 300.0, covariance, kind)
    assert isinstance(message, GpsMessage)
    assert (message.stamp_ns, message.frame_id) == (STAMP, "mast")
    assert (message.latitude, message.longitude, message.altitude) == (48.0, 7.5, 300.0)
    assert message.error == error


@pytest.mark.parametrize("ros", [1, 2])
def test_no_fix_is_nowhere(ros: int) -> None:
    status = Make(ros)("sensor_msgs/msg/NavSatStatus", -1, 0)
    message = decoded(ros, "NavSatFix", status, 0.0, 0.0, 0.0, np.zeros(9), 0)
    assert isinstance(message, GpsMessage)
    assert np.isnan(message.latitude)


def test_only_what_is_recent_belongs_to_a_frame() -> None:
    nowhere = GpsMessage(FIX.stamp_ns + 10, "", float("nan"), float("nan"), 0.0, 1.0)
    stamps = [FIX.stamp_ns + 10**9, FIX.stamp_ns + 10**9 + 1]
    entries: list[tuple[str, Message, int]] = [("/gps", m, m.stamp_ns) for m in (FIX, nowhere)]
    entries += [("/scan", scan_at(stamp), stamp) for stamp in stamps]
    entries += [("/tf_static", transform("base_link", "laser", (0, 0, 0)), 0)]
    log = MemoryLog(entries)
    plan = make_plan(survey_log(log), SensingConfig())
    first, second = read_frames(log, plan, SensingConfig())
    assert first.gps is FIX
    assert second.gps is None


def test_a_map_keeps_them_as_rtabmap_does(tmp_path: Path) -> None:
    """48 bytes of a fix, by the reference; read as a map and as a log."""
    path = tmp_path / "m.db"
    node = Node(1, 0, STAMP, np.eye(4), np.eye(4), gps=FIX)
    with open_store(path, create=True) as store:
        store.add_node(node, NodeData())
        store.add_node(Node(2, 0, STAMP + 10**9, np.eye(4), np.eye(4)), NodeData())
    sqlite = sqlite3.connect(path)
    rows = sqlite.execute("SELECT gps FROM Node ORDER BY id").fetchall()
    sqlite.close()
    assert struct.unpack("<6d", rows[0][0]) == (1_600_000_000.25, 7.8353, 48.0111, 245.5, 1.5, 0)
    assert rows[1] == (None,)
    with open_store(path, read_only=True) as store:
        again = store.nodes()
    assert same(again[0].gps, FIX)
    assert again[1].gps is None
    log = open_database_log(path)
    reported = {raw.topic: raw.decode() for raw in log.messages()}
    assert same(reported["/gps/fix"], FIX)
    counts = {topic.topic: topic.count for topic in log.info().topics}
    assert counts["/gps/fix"] == 1


def same(a: object, b: GpsMessage) -> bool:
    return type(a) is type(b) and all(getattr(a, n) == getattr(b, n) for n in type(b).__slots__)


def test_those_of_a_foreign_file(tmp_path: Path) -> None:
    fix = struct.pack("<6d", 12.5, 7.0, 48.0, 200.0, 2.0, 90.0)
    none = struct.pack("<6d", 0, 0, 0, 0, 0, 0)
    with rtabmap_file(tmp_path / "r.db") as database:
        add_nodes(database, 3)
        database.execute("UPDATE Node SET gps = ? WHERE id = 1", (fix,))
        database.execute("UPDATE Node SET gps = ? WHERE id = 2", (none,))
        database.execute("UPDATE Node SET gps = ? WHERE id = 3", (fix[:-1],))
    with open_store(tmp_path / "r.db") as store:
        first, second = store.nodes()
        problems = store.problems
    assert first.gps is not None
    assert (first.gps.latitude, first.gps.longitude, first.gps.error) == (48.0, 7.0, 2.0)
    assert second.gps is None
    assert any("node 3's gps" in line for line in problems)


def test_a_map_whose_fix_is_damaged_is_refused_in_one_line(tmp_path: Path) -> None:
    with open_store(tmp_path / "m.db", create=True) as store:
        store.add_node(Node(1, 0, STAMP, np.eye(4), np.eye(4), gps=FIX), NodeData())
    with closing(sqlite3.connect(tmp_path / "m.db")) as sqlite, sqlite:
        sqlite.execute("UPDATE Node SET gps = x'00'")
    sqlite.close()
    with (
        pytest.raises(MapError, match="node 1's gps"),
        open_store(tmp_path / "m.db", read_only=True) as store,
    ):
        store.nodes()
