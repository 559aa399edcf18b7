"""Every container, written by stock libraries, is read back message by message."""

from __future__ import annotations

import shutil
from collections.abc import Callable
from contextlib import closing
from pathlib import Path

import pytest
from log_builders import Built, drive, serialised, write_mcap, write_ros1, write_rosbag2

from formats.logs import open_log
from formats.logs.recorded_log import RecordedLog
from mapmyworld.errors import LogError
from mapmyworld.types import LaserScanMessage, MessageKind, OdometryMessage, TransformsMessage

ROS1, ROS2 = drive(1), drive(2)


def _split(folder: Path, write: Callable[[Path, list[Built]], Path], suffix: str) -> Path:
    folder.mkdir()
    for part in range(3):
        write(folder / f"part_{part * 5}{suffix}", ROS1[part::3])
    return folder


CONTAINERS: dict[str, tuple[int, Callable[[Path], Path]]] = {
    "bag": (1, lambda p: write_ros1(p / "a.bag", ROS1)),
    "bag, bz2": (1, lambda p: write_ros1(p / "a.bag", ROS1, "bz2", 2000)),
    "bag, lz4": (1, lambda p: write_ros1(p / "a.bag", ROS1, "lz4", 2000)),
    "split bags": (1, lambda p: _split(p / "f", write_ros1, ".bag")),
    "rosbag2 db3": (2, lambda p: write_rosbag2(p / "a", ROS2)),
    "rosbag2 db3, packed": (2, lambda p: write_rosbag2(p / "a", ROS2, mode="file")),
    "rosbag2 db3, messages packed": (2, lambda p: write_rosbag2(p / "a", ROS2, mode="message")),
    "rosbag2 mcap": (2, lambda p: write_rosbag2(p / "a", ROS2, "mcap")),
    "rosbag2 mcap, packed": (2, lambda p: write_rosbag2(p / "a", ROS2, "mcap", "file")),
    "lone db3": (2, lambda p: next(write_rosbag2(p / "a", ROS2).glob("*.db3")).rename(p / "b.db3")),
    "mcap": (2, lambda p: write_mcap(p / "a.mcap", ROS2)),
    "mcap, ROS 1": (1, lambda p: write_mcap(p / "a.mcap", ROS1, ros=1)),
    "mcap, lz4": (2, lambda p: write_mcap(p / "a.mcap", ROS2, compression="lz4", chunk_bytes=999)),
    "mcap, plain": (2, lambda p: write_mcap(p / "a.mcap", ROS2, compression="none")),
    "mcap, no chunks": (2, lambda p: write_mcap(p / "a.mcap", ROS2, use_chunking=False)),
    "mcap, no statistics": (2, lambda p: write_mcap(p / "a.mcap", ROS2, use_statistics=False)),
    "mcap, nothing repeated": (
        2,
        lambda p: write_mcap(
            p / "a.mcap", ROS2, chunk_bytes=2000, repeat_channels=False, repeat_schemas=False
        ),
    ),
}  # fmt: skip


@pytest.fixture(params=CONTAINERS, scope="module")
def written(
    request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory
) -> tuple[int, Path]:
    ros, write = CONTAINERS[request.param]
    return ros, write(tmp_path_factory.mktemp("log"))


def test_all_messages_come_back_in_order(written: tuple[int, Path]) -> None:
    ros, path = written
    expected = ROS1 if ros == 1 else ROS2
    messages = list(open_log([path]).messages())
    got = [(m.topic, m.log_time_ns, m.stamp_ns) for m in messages]
    wanted = [(t, log, None if t == "/chatter" else log) for t, _, log, _ in expected]
    if path.is_dir() and len(list(path.glob("*.bag"))) > 1:  # ties follow the files there
        assert sorted(got, key=str) == sorted(wanted, key=str)
        assert [g[1] for g in got] == sorted(g[1] for g in got)
    else:
        assert got == wanted


def test_messages_decode_alike_from_every_container(written: tuple[int, Path]) -> None:
    _, path = written
    messages = list(open_log([path]).messages({"/scan", "/odom", "/tf_static"}))
    scans = [m.decode() for m in messages if m.topic == "/scan"]
    assert all(isinstance(scan, LaserScanMessage) for scan in scans)
    assert [scan.ranges[0] for scan in scans] == list(range(40))  # type: ignore[union-attr]
    odometry = next(m.decode() for m in messages if m.kind is MessageKind.ODOMETRY)
    assert isinstance(odometry, OdometryMessage)
    assert (odometry.frame_id, odometry.child_frame_id) == ("odom", "base_link")
    static = messages[0].decode()
    assert isinstance(static, TransformsMessage)
    assert static.static


def test_reading_starts_again_and_gives_the_same(written: tuple[int, Path]) -> None:
    log = open_log([written[1]])
    first = [(m.topic, m.log_time_ns) for m in log.messages()]
    assert [(m.topic, m.log_time_ns) for m in log.messages()] == first
    assert log.info().problems == ()


def test_info_counts_without_decoding(written: tuple[int, Path]) -> None:
    ros, path = written
    expected = ROS1 if ros == 1 else ROS2
    info = open_log([path]).info()
    assert info.message_count == len(expected)
    assert {t.topic: t.count for t in info.topics} == {
        "/odom": 40, "/scan": 40, "/chatter": 10, "/tf_static": 1,
    }  # fmt: skip
    assert (info.start_ns, info.end_ns) == (expected[0][2], max(b[2] for b in expected))
    assert info.size_bytes > 0
    assert info.problems == ()
    kinds = {t.topic: t.kind for t in info.topics}
    assert kinds["/scan"] is MessageKind.LASER_SCAN
    assert kinds["/chatter"] is MessageKind.TEXT


def test_topics_choose(written: tuple[int, Path]) -> None:
    messages = list(open_log([written[1]]).messages({"/chatter"}))
    assert [m.topic for m in messages] == ["/chatter"] * 10
    assert list(open_log([written[1]]).messages(())) == []


def test_payloads_are_the_bytes_that_were_written(tmp_path: Path) -> None:
    for ros, path in ((1, write_ros1(tmp_path / "a.bag", ROS1, "lz4", 3000)),
                      (2, write_mcap(tmp_path / "a.mcap", ROS2, chunk_bytes=3000))):  # fmt: skip
        log = open_log([path])
        assert isinstance(log, RecordedLog)
        expected = [serialised(ros, built) for built in (ROS1 if ros == 1 else ROS2)]
        assert [data for _, _, data in log.records()] == expected


def test_content_hash_is_of_the_bytes(tmp_path: Path) -> None:
    a = write_mcap(tmp_path / "a.mcap", ROS2)
    b = Path(shutil.copy(a, tmp_path / "b.mcap"))
    c = write_mcap(tmp_path / "c.mcap", ROS2[:-1])
    hashes = [open_log([path]).content_hash() for path in (a, b, c)]
    assert hashes[0] == hashes[1] != hashes[2]
    assert len(hashes[0]) == 64


def test_several_paths_are_one_log_in_time_order(tmp_path: Path) -> None:
    middle = next(i for i in range(50, 60) if ROS1[i][2] != ROS1[i - 1][2])  # no tie is cut
    late = write_ros1(tmp_path / "1.bag", ROS1[middle:])
    early = write_mcap(tmp_path / "2.mcap", ROS2[:middle])
    log = open_log([late, early])
    got = [(m.topic, m.log_time_ns) for m in log.messages()]
    assert got == [(b[0], b[2]) for b in ROS1]
    assert log.info().message_count == len(ROS1)
    assert {t.topic: t.count for t in log.info().topics}["/scan"] == 40


def test_the_metadata_file_stands_for_its_folder(tmp_path: Path) -> None:
    folder = write_rosbag2(tmp_path / "a", ROS2)
    assert open_log([folder / "metadata.yaml"]).info().message_count == len(ROS2)


def test_a_listed_part_that_is_missing_is_reported(tmp_path: Path) -> None:
    folder = write_rosbag2(tmp_path / "a", ROS2)
    text = (folder / "metadata.yaml").read_text()
    name = next(folder.glob("*.db3")).name
    text = text.replace(f"- {name}", f"- {name}\n  - gone_1.db3")
    (folder / "metadata.yaml").write_text(text)
    log = open_log([folder])
    assert len(list(log.messages())) == len(ROS2)
    assert any("gone_1.db3" in loss for loss in log.info().problems)


@pytest.mark.parametrize(
    ("name", "content", "says"),
    [
        ("empty.mcap", b"", "empty"),
        ("text.mcap", b"these are words, not a log\n", "not a log"),
        ("old.bag", b"#ROSBAG V1.2\n", "rosbag migrate"),
        ("broken.db3", b"SQLite format 3\0" + bytes(200), "SQLite"),
        ("page.log", b"2024-01-01 INFO started\n", "not a log"),
        ("broken.clf.bz2", b"BZh91AY&SY no bz2", "cannot be read"),
    ],
)
def test_what_is_no_log_is_refused_in_one_clear_line(
    tmp_path: Path, name: str, content: bytes, says: str
) -> None:
    path = tmp_path / name
    path.write_bytes(content)
    with pytest.raises(LogError, match=says) as caught:
        open_log([path]).info()
    assert name in str(caught.value)
    assert "\n" not in str(caught.value)


def test_missing_paths_and_empty_folders_are_refused(tmp_path: Path) -> None:
    for path, says in (
        (tmp_path / "none.bag", "no such file"),
        (tmp_path, "no log in this folder"),
    ):
        with pytest.raises(LogError, match=says):
            open_log([path])
    with pytest.raises(LogError, match="no log given"):
        open_log([])


def test_other_databases_are_refused(tmp_path: Path) -> None:
    import sqlite3

    path = tmp_path / "a.db3"
    with closing(sqlite3.connect(path)) as database, database:
        database.execute("CREATE TABLE things (id INTEGER)")
    database.close()
    with pytest.raises(LogError, match="neither a rosbag2"):
        open_log([path])
