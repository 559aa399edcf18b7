"""Damaged logs: what is sound is read, the rest is reported, and nothing but LogError is raised."""

from __future__ import annotations

import contextlib
import shutil
import sqlite3
import struct
from collections.abc import Callable
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import HealthCheck, example, given, settings
from hypothesis import strategies as st
from log_builders import (
    Built,
    allowed,
    changes,
    drive,
    serialised,
    write_mcap,
    write_ros1,
    write_rosbag2,
)

from formats.logs import open_log
from formats.logs.mcap_records import MAGIC, record_head
from formats.logs.merged import MergedLog
from formats.logs.recorded_log import RecordedLog
from formats.logs.sqlite_pages import salvage
from mapmyworld.errors import LogError
from mapmyworld.sensing import survey_log

DRIVES: dict[int, list[Built]] = {ros: drive(ros, 12) for ros in (1, 2)}
PAYLOADS = {ros: [serialised(ros, built) for built in DRIVES[ros]] for ros in (1, 2)}
FILES: dict[str, tuple[int, Callable[[Path], Path]]] = {
    "zstd.mcap": (2, lambda p: write_mcap(p, DRIVES[2], chunk_bytes=3000)),
    "lz4.mcap": (2, lambda p: write_mcap(p, DRIVES[2], chunk_bytes=3000, compression="lz4")),
    "plain.mcap": (2, lambda p: write_mcap(p, DRIVES[2], chunk_bytes=3000, compression="none")),
    "bare.mcap": (2, lambda p: write_mcap(p, DRIVES[2], use_chunking=False)),
    "ros1.mcap": (1, lambda p: write_mcap(p, DRIVES[1], ros=1, chunk_bytes=3000)),
    "none.bag": (1, lambda p: write_ros1(p, DRIVES[1], chunk_bytes=3000)),
    "bz2.bag": (1, lambda p: write_ros1(p, DRIVES[1], "bz2", chunk_bytes=3000)),
    "lz4.bag": (1, lambda p: write_ros1(p, DRIVES[1], "lz4", chunk_bytes=3000)),
}
CHECKED = {"zstd.mcap", "lz4.mcap", "plain.mcap", "ros1.mcap"}  # by a CRC over each chunk


@pytest.fixture(scope="module")
def whole(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with the whole files: hypothesis shows arguments, and would show their bytes."""
    folder = tmp_path_factory.mktemp("whole")
    for name, (_, write) in FILES.items():
        write(folder / name)
    return folder


def read(path: Path) -> tuple[list[tuple[str, int, bytes]], tuple[str, ...]]:
    """Whatever can be read, decoded where it decodes; LogError is the only error allowed."""
    log = open_log([path])
    log.info()
    for message in log.messages():
        try:
            message.decode()
        except LogError:
            continue
    if not isinstance(log, RecordedLog | MergedLog):
        return [], log.info().problems
    records = [(channel.topic, time, data) for time, channel, data in log.records()]
    return records, log.info().problems


def boundaries(data: bytes) -> list[int]:
    """Where top-level records of an MCAP file or a ROS 1 bag end."""
    found, position = [], len(MAGIC)
    if data.startswith(MAGIC):
        while position < len(data) - len(MAGIC):
            position += 9 + record_head(data, position)[1]
            found.append(position)
        return found
    position = 13
    while position < len(data):
        for _ in range(2):
            position += 4 + struct.unpack_from("<I", data, position)[0]
        found.append(position)
    return found


def chunks(data: bytes) -> list[tuple[int, int]]:
    """Start and end of the chunk records."""
    starts = [len(MAGIC) if data.startswith(MAGIC) else 13, *boundaries(data)]
    spans = pairwise(starts)
    if data.startswith(MAGIC):
        return [(a, b) for a, b in spans if data[a] == 6]
    return [(a, b) for a, b in spans if b"op=\x05" in data[a : a + 80]]


def expected_of(name: str) -> list[tuple[str, int, bytes]]:
    ros = FILES[name][0]
    return [(b[0], b[2], data) for b, data in zip(DRIVES[ros], PAYLOADS[ros], strict=True)]


@pytest.mark.parametrize("name", FILES)
def test_a_file_cut_at_any_record_keeps_all_before(whole: Path, name: str, tmp_path: Path) -> None:
    data, expected = (whole / name).read_bytes(), expected_of(name)
    path = tmp_path / name
    most = 0
    for cut in boundaries(data)[:-1]:
        path.write_bytes(data[:cut])
        records, losses = read(path)
        assert records == expected[: len(records)]
        assert len(records) >= most  # a longer file never gives less
        assert losses
        most = len(records)
    assert most == len(expected)


@pytest.mark.parametrize("name", FILES)
def test_a_file_cut_anywhere_keeps_whole_chunks(whole: Path, name: str, tmp_path: Path) -> None:
    data, expected = (whole / name).read_bytes(), expected_of(name)
    ends = boundaries(data)
    counts = {}
    path = tmp_path / name
    for end in ends:
        path.write_bytes(data[:end])
        counts[end] = len(read(path)[0])
    for cut in range(20, len(data), max(len(data) // 25, 1)):
        path.write_bytes(data[:cut])
        records, losses = read(path)
        whole = max((counts[end] for end in ends if end <= cut), default=0)
        assert records == expected[: len(records)]
        assert len(records) >= whole
        assert losses


@pytest.mark.parametrize("name", ["zstd.mcap", "plain.mcap", "bz2.bag", "lz4.bag"])
def test_a_bad_chunk_is_skipped_and_reported(whole: Path, name: str, tmp_path: Path) -> None:
    data = bytearray((whole / name).read_bytes())
    start, end = chunks((whole / name).read_bytes())[1]
    middle = (start + end) // 2
    data[middle : middle + 40] = bytes(40)
    path = tmp_path / name
    path.write_bytes(data)
    records, losses = read(path)
    expected = expected_of(name)
    assert len(losses) == 1
    assert name in losses[0]
    assert set(records) < set(expected)
    assert len(records) >= len(expected) // 3


@pytest.mark.parametrize("name", FILES)
@settings(max_examples=60, suppress_health_check=list(HealthCheck))
@given(flips=changes(least=1))
@example(flips=[(0.887135319980832, 0)])  # a channel of the summary becomes a message
@example(flips=[(0.875, 0), (0.25, 0), (0.1723375713112405, 0)])  # a message of a broken chunk
@example(flips=[(0.9140625, 0), (0.125, 0)])  # the one chunk that names a topic, and its other copy
def test_flipped_bytes_never_raise_anything_else(
    whole: Path, name: str, tmp_path: Path, flips: list[tuple[float, int]]
) -> None:
    data = bytearray((whole / name).read_bytes())
    for place, change in flips:
        data[int(place * len(data))] ^= change or 1
    path = tmp_path / name
    path.write_bytes(data)
    found = allowed(lambda: read(path))
    if found is not None and name in CHECKED:
        records, losses = found
        if any(
            "summary" in line for line in losses
        ):  # reported; it may be all that names the topics
            sound = {record[1:] for record in expected_of(name)}
            assert {record[1:] for record in records} <= sound
        else:
            assert set(records) <= set(expected_of(name)) or losses == ()


def without_footer(whole: Path) -> bytearray:
    """A file of plain chunks whose summary nothing vouches for."""
    return bytearray((whole / "plain.mcap").read_bytes()[:-1] + b"?")


def test_of_a_chunk_with_a_damaged_head_no_message_is_taken(whole: Path, tmp_path: Path) -> None:
    """Its checksum looks like the rest, and one of its messages is damaged as well."""
    data = without_footer(whole)
    start, end = chunks(bytes(data))[1]
    data[start + 42] ^= 1  # how many bytes of messages it holds
    data[(start + end) // 2] ^= 1
    (tmp_path / "a.mcap").write_bytes(data)
    records, losses = read(tmp_path / "a.mcap")
    assert set(records) < set(expected_of("plain.mcap"))
    assert any("a chunk contradicts itself" in line for line in losses)


def test_an_index_of_messages_that_became_a_message_is_none(whole: Path, tmp_path: Path) -> None:
    """Both begin with channel, a number and a time."""
    data = without_footer(whole)
    at = next(place for place, opcode in mcap_places(bytes(data)) if opcode == 7)
    data[at] = 5
    (tmp_path / "a.mcap").write_bytes(data)
    assert read(tmp_path / "a.mcap")[0] == expected_of("plain.mcap")


def test_topics_that_only_an_unchecked_summary_names_are_reported(
    whole: Path, tmp_path: Path
) -> None:
    data = without_footer(whole)
    start, end = chunks(bytes(data))[0]
    data[(start + end) // 2] ^= 1
    data[data.rindex(b"/odom") + 1] = ord("a")
    (tmp_path / "a.mcap").write_bytes(data)
    records, losses = read(tmp_path / "a.mcap")
    assert {topic for topic, *_ in records} >= {"/adom"}
    (reported,) = (line for line in losses if "only its summary" in line)
    assert "/adom" in reported


@pytest.mark.parametrize("name", ["a.mcap", "a.bag", "a.log", "a.db3"])
@settings(max_examples=60, suppress_health_check=list(HealthCheck))
@given(content=st.binary(max_size=600))
def test_noise_behind_a_good_start_is_survived(name: str, tmp_path: Path, content: bytes) -> None:
    start = {
        "a.mcap": MAGIC,
        "a.bag": b"#ROSBAG V2.0\n",
        "a.log": b"FLASER 2 1.0 2.0 0 0 0 0 0 0 1.5 host 1.5\n",
        "a.db3": b"SQLite format 3\0",
    }
    path = tmp_path / name
    path.write_bytes(start[name] + content)
    found = allowed(lambda: read(path), name)
    assert found is None or found[1] or name == "a.log"


def test_absurd_sizes_are_refused_without_memory(whole: Path, tmp_path: Path) -> None:
    """A chunk that claims 2^60 bytes, compressed or not, is one bad chunk."""
    for name, field in (("zstd.mcap", 16), ("lz4.mcap", 16)):
        data = bytearray((whole / name).read_bytes())
        start = data.index(b"zstd" if "zstd" in name else b"lz4") - 4 - 28
        data[start + field : start + field + 8] = (1 << 60).to_bytes(8, "little")
        path = tmp_path / name
        path.write_bytes(data)
        records, losses = read(path)
        assert 0 < len(records) < len(expected_of(name))
        assert "claims" in losses[0]


def test_a_bag_that_was_never_closed_is_read_by_its_chunks(whole: Path, tmp_path: Path) -> None:
    """index_pos 0, as rosbag leaves it when the recorder is killed."""
    data = bytearray((whole / "lz4.bag").read_bytes())
    at = data.index(b"index_pos=") + len(b"index_pos=")
    data[at : at + 8] = bytes(8)
    path = tmp_path / "a.bag.active"
    path.write_bytes(data)
    records, losses = read(path)
    assert records == expected_of("lz4.bag")
    assert "not closed" in losses[0]


def test_a_lying_footer_is_not_believed(whole: Path, tmp_path: Path) -> None:
    data = bytearray((whole / "zstd.mcap").read_bytes())
    data[-37 + 9 : -37 + 17] = (1 << 62).to_bytes(8, "little")
    path = tmp_path / "a.mcap"
    path.write_bytes(data)
    records, losses = read(path)
    assert records == expected_of("zstd.mcap")
    assert losses == ()


def kept_of(built: list[Any], data: bytes, pages: range) -> list[tuple[str, int, bytes]]:
    """Messages of which no byte stands in these pages; recognised by where their bytes are."""
    gone = range(pages.start * 4096, pages.stop * 4096)
    found = []
    for record in built:
        place = data.find(record[2])
        assert place >= 0
        if not (place < gone.stop and place + len(record[2]) > gone.start):
            found.append(record)
    return found


def test_a_torn_db3_gives_all_but_the_torn_pages(tmp_path: Path) -> None:
    path = next(write_rosbag2(tmp_path / "a", drive(2, 300)).glob("*.db3"))
    data, (whole, _) = path.read_bytes(), read(path)
    middle = len(data) // 2 // 4096
    for garbage in (b"\xff", b"\0", b"\x0d"):
        torn = bytearray(data)
        torn[middle * 4096 : (middle + 3) * 4096] = garbage * 3 * 4096
        path.write_bytes(torn)
        records, losses = read(path)
        assert records == kept_of(whole, data, range(middle, middle + 3))
        assert "page by page" in losses[0]
        assert f"{len(whole) - len(records)} missed" in losses[0]


def test_a_cut_db3_gives_what_precedes_the_cut(tmp_path: Path) -> None:
    """SQLite reads nothing of it: the file says how long it should be."""
    path = next(write_rosbag2(tmp_path / "a", drive(2, 300)).glob("*.db3"))
    data, (whole, _) = path.read_bytes(), read(path)
    pages = len(data) // 4096
    for share in (0.3, 0.5, 0.9, 0.99):
        path.write_bytes(data[: int(len(data) * share)])
        records, losses = read(path)
        assert records == kept_of(whole, data, range(int(pages * share), pages))
        assert "page by page" in losses[0]
        assert open_log([path]).info().topics


def test_rows_longer_than_a_page_are_salvaged_whole(tmp_path: Path) -> None:
    """Images run over chains of pages; one whose chain is cut is not given in part."""
    path = tmp_path / "long.db3"
    rng = np.random.default_rng(0)
    sizes = [10, 4060, 4061, 4096, 5000, 40_000, 123_456, 3]
    with contextlib.closing(sqlite3.connect(path)) as database, database:
        database.execute("CREATE TABLE topics(id INTEGER PRIMARY KEY, name TEXT, type TEXT, "
                         "serialization_format TEXT)")  # fmt: skip
        database.execute("CREATE TABLE messages(id INTEGER PRIMARY KEY, topic_id INTEGER, "
                         "timestamp INTEGER, data BLOB)")  # fmt: skip
        database.execute("INSERT INTO topics VALUES (1, '/a', 'std_msgs/msg/String', 'cdr')")
        rows = [(1, 10**18 + k, rng.bytes(size)) for k, size in enumerate(sizes)]
        database.executemany("INSERT INTO messages VALUES (NULL, ?, ?, ?)", rows)
    whole = [(cell[0], found.data(cell[3])) for found in [salvage(path)] for cell in found.messages]
    assert whole == [(time, data) for _, time, data in rows]
    data = path.read_bytes()
    path.write_bytes(data[: data.find(rows[6][2][90_000:90_100])])
    cut = salvage(path)
    assert [time for time, *_ in cut.messages] == [t for _, t, d in rows if len(d) != 123_456]


def test_a_message_shorter_than_its_head_costs_no_other(tmp_path: Path) -> None:
    """In a file without chunks; found by Atheris."""
    data = FILES["bare.mcap"][1](tmp_path / "bare.mcap").read_bytes()
    whole, _ = read(tmp_path / "bare.mcap")
    short = bytes([5]) + (4).to_bytes(8, "little") + bytes(4)
    end = next(p for p, op in mcap_places(data) if op == 15)
    path = tmp_path / "a.mcap"
    path.write_bytes(data[:end] + short)
    records, losses = read(path)
    assert records == whole
    assert losses
    path.write_bytes(MAGIC + short)
    allowed(lambda: read(path), str(path))


def test_a_damaged_definition_costs_no_message(tmp_path: Path) -> None:
    """In a file without chunks, where nothing is known yet of the messages behind it."""
    data = bytearray(FILES["bare.mcap"][1](tmp_path / "bare.mcap").read_bytes())
    whole, _ = read(tmp_path / "bare.mcap")
    place = next(at for at, opcode in mcap_places(bytes(data)) if opcode == 4)
    data[place + 9 + 7] ^= 0x55  # how long the topic's name is, which its record's length belies
    (tmp_path / "a.mcap").write_bytes(data)
    records, losses = read(tmp_path / "a.mcap")
    assert records == whole  # the summary names the topic once more
    assert any(f"record at byte {place} skipped" in line for line in losses)


def mcap_places(data: bytes) -> list[tuple[int, int]]:
    """Where the records of a file begin, and their opcodes."""
    found, at = [], len(MAGIC)
    while at < len(data) - len(MAGIC):
        opcode, length = record_head(data, at)
        found.append((at, opcode))
        at += 9 + length
    return found


@pytest.mark.parametrize("time", [-(1 << 62), 1 << 62, (1 << 63) - 1, "text", None, 1.5])
def test_a_time_that_is_none_costs_no_other_message(tmp_path: Path, time: object) -> None:
    path = next(write_rosbag2(tmp_path / "a", DRIVES[2]).glob("*.db3"))
    with contextlib.closing(sqlite3.connect(path)) as database, database:
        database.execute("CREATE TABLE loose AS SELECT * FROM messages")  # without constraints
        database.execute("DROP TABLE messages")
        database.execute("ALTER TABLE loose RENAME TO messages")
        database.execute("UPDATE messages SET timestamp = ? WHERE id = 5", (time,))
    log = open_log([path])
    times = [raw.log_time_ns for raw in log.messages()]
    assert all(0 <= found < 1 << 62 for found in times)
    assert len(times) >= len(DRIVES[2]) - 1
    assert survey_log(log).streams
    reported = any("have no time" in line for line in log.info().problems)
    assert reported == (not isinstance(time, int))


def test_a_topic_without_number_costs_its_messages_and_no_others(tmp_path: Path) -> None:
    """As SQLite allows where the column is not declared a key; found by Atheris."""
    path = next(write_rosbag2(tmp_path / "a", DRIVES[2]).glob("*.db3"))
    whole = open_log([path]).info().topics
    with contextlib.closing(sqlite3.connect(path)) as database, database:
        database.execute("CREATE TABLE loose AS SELECT * FROM topics")
        database.execute("DROP TABLE topics")
        database.execute("ALTER TABLE loose RENAME TO topics")
        database.execute("UPDATE topics SET id = NULL WHERE id = 1")
    log = open_log([path])
    assert len(log.info().topics) == len(whole) - 1
    assert len(list(log.messages())) == sum(t.count for t in log.info().topics)
    assert any("has no number" in line for line in log.info().problems)


def test_damage_that_sqlite_quotes_back_is_refused_in_words(tmp_path: Path) -> None:
    """Its message then holds bytes that are no UTF-8."""
    path = next(write_rosbag2(tmp_path / "a", DRIVES[2]).glob("*.db3"))
    spoilt = path.read_bytes().replace(b"CREATE TABLE messages", b"CREATE TABLE \xd2essage(")
    path.write_bytes(spoilt)
    with pytest.raises(LogError, match="damaged SQLite file"):
        open_log([path])


def test_a_write_ahead_log_beside_the_file_is_read_too(tmp_path: Path) -> None:
    """What a killed recorder leaves: rows that never reached the file itself."""
    folder = write_rosbag2(tmp_path / "a", DRIVES[2])
    path = next(folder.glob("*.db3"))
    database = sqlite3.connect(path)
    database.execute("PRAGMA journal_mode=WAL")
    database.execute(
        "INSERT INTO messages (topic_id, timestamp, data) "
        "SELECT topic_id, timestamp + 1000000000, data FROM messages"
    )
    database.commit()
    killed = tmp_path / "killed"
    killed.mkdir()
    for part in folder.glob("*.db3*"):
        shutil.copy(part, killed)
    database.close()
    records, losses = read(killed)
    assert len(records) == 2 * len(DRIVES[2])
    assert losses == ()


def test_a_cut_packed_file_is_read_as_far_as_it_goes(tmp_path: Path) -> None:
    folder = write_rosbag2(tmp_path / "a", drive(2, 3000), "mcap", "file")
    path = next(folder.glob("*.zstd"))
    path.write_bytes(path.read_bytes()[:-2000])
    records, losses = read(path)
    assert len(records) > 3000
    assert losses
