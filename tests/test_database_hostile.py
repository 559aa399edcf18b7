"""Databases that lie: claims are checked before memory is spent on them, and named in one line."""

from __future__ import annotations

import contextlib
import math
import sqlite3
import struct
import tracemalloc
import zlib
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from database_samples import fill
from foreign_database import add_nodes, insert, matrix, mono, rtabmap_file, scan_info, stereo
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from formats.database import open_store
from formats.database.blobs import blob_to_matrix, blob_to_pose
from formats.database.calibration import blob_to_eyes
from formats.database.image_blobs import decode_depth, decode_picture
from formats.database.scan_blobs import blob_to_scan, columns_to_observation, scan_to_blob
from mapmyworld.errors import MapError
from mapmyworld.map_figures import map_figures
from mapmyworld.types import Scan, TrackedFrames

POINTS = np.ones((1, 10, 2), np.float32)


@pytest.mark.parametrize(
    "blob",
    [
        matrix(POINTS, cols=11),
        matrix(POINTS, cols=9),
        matrix(POINTS, rows=1 << 30, cols=1 << 30),
        matrix(POINTS, rows=-1),
        matrix(POINTS, kind=7),
        matrix(POINTS, kind=-3),
        matrix(POINTS, kind=5 + 8 * 1000),
        matrix(POINTS)[6:],
        b"nonsense nonsense",
        b"12345",
    ],
)
def test_matrices_that_lie(blob: bytes) -> None:
    with pytest.raises(MapError) as caught:
        blob_to_matrix(blob, "node 3's scan")
    assert "node 3's scan" in str(caught.value)
    assert "\n" not in str(caught.value)


def test_a_zlib_bomb_does_not_fill_the_memory() -> None:
    """A hundred megabytes of zeros in a tenth of one, announced as ten numbers."""
    bomb = zlib.compress(bytes(100 << 20), 9) + struct.pack("<3i", 1, 10, 5)
    tracemalloc.start()
    with pytest.raises(MapError, match="holds more"):
        blob_to_matrix(bomb, "scan")
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert peak < 1 << 20


def test_a_bomb_that_indicates_its_size_is_refused_by_it() -> None:
    huge = zlib.compress(bytes(1 << 20), 9) + struct.pack("<3i", 1 << 14, 1 << 14, 5)
    with pytest.raises(MapError, match="cannot hold"):
        blob_to_matrix(huge, "scan")


def png(width: int, height: int) -> bytes:
    body = b"IHDR" + struct.pack(">2I5B", width, height, 8, 0, 0, 0, 0)
    chunk = struct.pack(">I", 13) + body + struct.pack(">I", zlib.crc32(body))
    return b"\x89PNG\r\n\x1a\n" + chunk


def jpeg(width: int, height: int) -> bytes:
    frame = struct.pack(">2B2H2H", 0xFF, 0xC0, 11, 0x0800 | height >> 8, 0, width)
    frame = b"\xff\xc0" + struct.pack(">HBHHB", 11, 8, height, width, 1) + b"\1\x11\0"
    return b"\xff\xd8" + frame + b"\xff\xd9"


@pytest.mark.parametrize(
    "data",
    [
        png(100_000, 100_000),
        png(0, 10),
        png(10, 10),
        jpeg(65_000, 65_000),
        jpeg(10, 10),
        b"\xff\xd8\xff",
        b"GIF89a" + bytes(100),
        b"DEPTHRVL" + struct.pack("<2I", 1 << 20, 1 << 20) + bytes(8),
        b"DEPTHRVL" + struct.pack("<2I", 640, 480) + bytes(8),
        b"DEPTHRVL" + struct.pack("<2I", 4, 4) + b"\xff" * 64,
        b"DEPTHRVL",
    ],
)
def test_images_that_lie(data: bytes) -> None:
    for decode in (decode_picture, decode_depth):
        with pytest.raises(MapError) as caught:
            decode(data, "node 3's image")
        assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    "blob",
    [
        mono()[:-1],
        mono()[:20],
        mono() + b"\0",
        mono(width=-4),
        mono(width=1 << 30),
        struct.pack("<11i", 0, 20, 0, 0, 64, 48, 1 << 28, 0, 0, 0, 12) + bytes(100),
        struct.pack("<10i", 0, 20, 0, 1, -9, 0, 0, 0, 100, 100) + bytes(300),
        stereo()[:-10],
        mono(fx=0.0),
        mono(fx=-60.0),
        mono(fx=math.nan),
        mono(tx=math.inf),
        struct.pack("<11i", 0, 20, 0, 7, 64, 48, 9, 0, 0, 0, 12) + bytes(300),
    ],
)
def test_calibrations_that_lie(blob: bytes) -> None:
    with pytest.raises(MapError) as caught:
        blob_to_eyes(blob, "node 3's calibration")
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    "change",
    [
        {"angle_increment": math.nan},
        {"range_max": math.nan},
        {"origin": np.array([0.0, math.inf, 0.0])},
        {"points": np.array([[1.0, math.nan]], np.float32)},
        {"missing": np.array([-math.inf], np.float32)},
    ],
)
def test_scans_that_are_no_numbers(change: dict[str, Any]) -> None:
    sound = Scan(np.ones((3, 2), np.float32), np.zeros(3), np.ones(1, np.float32), math.inf, 0.01)
    assert blob_to_scan(scan_to_blob(sound), "x").range_max == math.inf
    with pytest.raises(MapError, match="node 3's scan: a scan"):
        blob_to_scan(scan_to_blob(replace(sound, **change)), "node 3's scan")


@pytest.mark.parametrize(
    "array", [np.eye(4)[None], np.zeros((2, 3, 3)), np.zeros((2, 4, 4), np.int64), np.zeros(32)]
)
def test_arrays_of_another_shape_are_damage(tmp_path: Path, array: NDArray[Any]) -> None:
    """Two frames were tracked; the places of one, or of something else, are none of theirs."""
    frames = np.zeros(2, np.int64), np.ones(2, np.int64), np.stack([np.eye(4)] * 2)
    with open_store(tmp_path / "map.db", create=True) as store:
        store.set_tracked_frames(TrackedFrames(*frames, np.ones(2, np.bool_)))
        store.set_frame_poses(array)
    with open_store(tmp_path / "map.db") as store, pytest.raises(MapError, match="damaged array"):
        store.frame_poses()


@given(st.binary(max_size=200))
@settings(max_examples=200)
def test_no_bytes_at_all_bring_a_decoder_down(data: bytes) -> None:
    """Whatever the bytes, the answer is a value or a MapError."""
    decoders = (
        lambda: blob_to_matrix(data, "x"),
        lambda: blob_to_pose(data, "x"),
        lambda: blob_to_eyes(data, "x"),
        lambda: decode_picture(data, "x"),
        lambda: decode_depth(b"DEPTHRVL" + data, "x"),
        lambda: blob_to_scan(data, "x"),
        lambda: columns_to_observation(matrix(POINTS), data, None, "x"),
    )
    for decode in decoders:
        with contextlib.suppress(MapError):
            decode()


def test_one_bad_node_does_not_spoil_the_others(tmp_path: Path) -> None:
    with rtabmap_file(tmp_path / "r.db") as sqlite:
        add_nodes(sqlite, 2)
        sqlite.execute("UPDATE Node SET stamp = 1e300 WHERE id = 2")
        insert(sqlite, "Data", id=1, scan=matrix(POINTS, cols=99), scan_info=scan_info(1))
        insert(sqlite, "Node", id=3, map_id=0, weight=0, stamp=1.0, pose=b"bad")
    with open_store(tmp_path / "r.db") as store:
        assert [node.id for node in store.nodes()] == [1]
        assert len(store.problems) == 2
        with pytest.raises(MapError, match="node 1's scan"):
            store.node_data(1)


def test_columns_of_the_wrong_type(tmp_path: Path) -> None:
    """SQLite holds any type in any column."""
    with rtabmap_file(tmp_path / "r.db") as sqlite:
        add_nodes(sqlite, 1)
        insert(sqlite, "Data", id=1, scan="text", image=5)
        insert(sqlite, "Node", id=2, map_id=0, weight=0, stamp="noon", pose="here")
    with open_store(tmp_path / "r.db") as store:
        assert [node.id for node in store.nodes()] == [1]
        with pytest.raises(MapError):
            store.node_data(1)


def read_all(path: Path) -> None:
    with open_store(path) as store:
        store.tracked_frames()
        list(store.scans(range(9)))
        for node in store.nodes():
            store.node_data(node.id)
        store.get("plan")
        list(store.constraints())
        store.poses()
        store.frame_poses()
        store.grid()


@pytest.mark.parametrize(
    ("table", "column", "value"),
    [
        ("mapmyworld_format", "version", b"one"),
        ("mapmyworld_format", "version", "two"),
        ("mapmyworld_nodes", "cloud", 7),
        ("mapmyworld_nodes", "scan_rest", -1),
        ("mapmyworld_nodes", "image_stamps", "5"),
        ("mapmyworld_nodes", "image_stamps", "[1.5]"),
        ("mapmyworld_nodes", "image_stamps", "[1, "),
        ("mapmyworld_scans", "scan", 3),
        ("mapmyworld_arrays", "dtype", "1 2"),
        ("mapmyworld_arrays", "dtype", "O"),
        ("mapmyworld_arrays", "shape", "[4611686018427387904, 4]"),
        ("Feature", "pos_x", 1e300),
        ("Feature", "pos_y", -math.inf),
        ("Feature", "response", 1e300),
        ("mapmyworld_keys", "value", "[" * 100_000),
        ("mapmyworld_nodes", "stamp_ns", "noon"),
        ("mapmyworld_constraints", "from_id", b"bytes"),
        ("mapmyworld_constraints", "i_from_j", np.full((4, 4), 1e300).tobytes()),
        ("mapmyworld_constraints", "information", np.full((6, 6), np.nan).tobytes()),
        ("mapmyworld_constraints", "source", "Sonar"),
        ("mapmyworld_constraints", "source", b"bytes"),
        ("mapmyworld_constraints", "figures", '{"inliers": "many"}'),
        ("mapmyworld_constraints", "figures", '{"colour": 1}'),
        ("mapmyworld_constraints", "figures", "[1]"),
        ("mapmyworld_verdicts", "judge", "jury"),
        ("mapmyworld_verdicts", "why", b"bytes"),
        ("mapmyworld_verdicts", "numbers", "[1]"),
        ("mapmyworld_verdicts", "numbers", '{"inliers": [1]}'),
        ("mapmyworld_verdicts", "note", b"bytes"),
        ("mapmyworld_nodes", "odom_from_base", np.full((4, 4), 1e300).tobytes()),
    ],
)
def test_a_map_of_ours_with_other_types_in_it(
    tmp_path: Path, table: str, column: str, value: object
) -> None:
    path = tmp_path / "map.db"
    with open_store(path, create=True) as store:
        fill(store)
    with contextlib.closing(sqlite3.connect(path)) as sqlite, sqlite:
        sqlite.execute(f"UPDATE {table} SET {column} = ?", (value,))
    with pytest.raises(MapError) as caught:
        read_all(path)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize("value", [math.nan, math.inf, -1e300])
@pytest.mark.parametrize("name", ["poses map_from_node", "frame poses", "grid figures"])
def test_numbers_beyond_sense_in_packed_arrays(tmp_path: Path, name: str, value: float) -> None:
    path = tmp_path / "map.db"
    with open_store(path, create=True) as store:
        fill(store)
    with contextlib.closing(sqlite3.connect(path)) as sqlite, sqlite:
        where = "FROM mapmyworld_arrays WHERE name = ?"
        numbers = np.frombuffer(
            zlib.decompress(sqlite.execute(f"SELECT data {where}", (name,)).fetchone()[0])
        )
        spoilt = zlib.compress(np.where(np.arange(len(numbers)) == 2, value, numbers).tobytes())
        sqlite.execute("UPDATE mapmyworld_arrays SET data = ? WHERE name = ?", (spoilt, name))
    with pytest.raises(MapError, match=f"{name}: a damaged array"):
        read_all(path)


def test_tracked_frames_of_a_node_that_is_none_are_damage(tmp_path: Path) -> None:
    """Found by the campaign: the duration of the sessions is that of the frames' nodes."""
    with open_store(tmp_path / "map.db", create=True) as store:
        fill(store)
        frames = store.tracked_frames()
        store.set_tracked_frames(replace(frames, node_ids=frames.node_ids + 90))
    with open_store(tmp_path / "map.db") as store, pytest.raises(MapError, match="of node 9"):
        map_figures(store)


def test_tracked_frames_of_a_node_that_misses_one_of_its_rows_are_damage(tmp_path: Path) -> None:
    with open_store(tmp_path / "map.db", create=True) as store:
        fill(store)
    with contextlib.closing(sqlite3.connect(tmp_path / "map.db")) as sqlite, sqlite:
        sqlite.execute("DELETE FROM Node WHERE id = 2")
    with open_store(tmp_path / "map.db") as store, pytest.raises(MapError, match="of node 2"):
        map_figures(store)
