"""Small databases such as RTAB-Map writes, made here row by row for the reader to swallow."""

from __future__ import annotations

import sqlite3
import struct
import zlib
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np

TABLES = {
    "Node": "id INTEGER PRIMARY KEY, map_id INTEGER, weight INTEGER, stamp FLOAT, pose BLOB,"
    " ground_truth_pose BLOB, velocity BLOB, label TEXT, gps BLOB",
    "Data": "id INTEGER PRIMARY KEY, image BLOB, depth BLOB, calibration BLOB, scan BLOB,"
    " scan_info BLOB, user_data BLOB",
    "Link": "from_id INTEGER, to_id INTEGER, type INTEGER, information_matrix BLOB,"
    " transform BLOB, user_data BLOB",
    "Word": "id INTEGER PRIMARY KEY, descriptor_size INTEGER, descriptor BLOB",
    "Feature": "node_id INTEGER, word_id INTEGER, pos_x FLOAT, pos_y FLOAT, size INTEGER,"
    " dir FLOAT, response FLOAT, octave INTEGER, depth_x FLOAT, depth_y FLOAT, depth_z FLOAT,"
    " descriptor_size INTEGER, descriptor BLOB",
    "Info": "parameters TEXT, time_enter DATE",
    "Admin": "version TEXT, opt_ids BLOB, opt_poses BLOB, opt_map BLOB, opt_map_x_min FLOAT,"
    " opt_map_y_min FLOAT, opt_map_resolution FLOAT",
}


@contextmanager
def rtabmap_file(path: Path, version: str = "0.21.4") -> Iterator[sqlite3.Connection]:
    """An empty database of this version, to be filled; closed at the end."""
    sqlite = sqlite3.connect(path)
    for name, columns in TABLES.items():
        sqlite.execute(f"CREATE TABLE {name} ({columns})")
    sqlite.execute("INSERT INTO Admin (version) VALUES (?)", (version,))
    yield sqlite
    sqlite.commit()
    sqlite.close()


def insert(sqlite: sqlite3.Connection, table: str, **values: Any) -> None:
    marks = ",".join("?" * len(values))
    sql = f"INSERT INTO {table} ({','.join(values)}) VALUES ({marks})"
    sqlite.execute(sql, tuple(values.values()))


def add_nodes(sqlite: sqlite3.Connection, count: int) -> None:
    """Nodes 1..count along the x axis, a second and a metre apart."""
    for i in range(count):
        at = (1.0, 0.0, 0.0, float(i), 0.0, 1.0, 0.0, 0.0, 0.0, 0.0, 1.0, 0.0)
        insert(sqlite, "Node", id=i + 1, map_id=0, weight=0, stamp=10.5 + i, pose=floats(*at))


def floats(*values: float) -> bytes:
    return struct.pack(f"<{len(values)}f", *values)


def ahead(metres: float) -> bytes:
    """The transform of a step along x."""
    return floats(1, 0, 0, metres, 0, 1, 0, 0, 0, 0, 1, 0)


def information(*diagonal: float) -> bytes:
    """288 bytes, x y z roll pitch yaw."""
    return np.diag(diagonal or (1.0, 2, 3, 4, 5, 6)).astype("<f8").tobytes()


def matrix(values: np.ndarray, **lies: int) -> bytes:
    """A compressed matrix (rows, cols, channels); `lies` replace what its trailer states."""
    kinds = {"u1": 0, "i1": 1, "i4": 4, "f4": 5}
    rows, cols, channels = values.shape
    kind = kinds[values.dtype.str[1:]] + 8 * (channels - 1)
    said = {"rows": rows, "cols": cols, "kind": kind} | lies
    return zlib.compress(values.tobytes()) + struct.pack("<3i", *said.values())


def mono(width: int = 64, height: int = 48, fx: float = 60.0, tx: float | None = None) -> bytes:
    """A calibration record with K alone, or with a P whose P[0, 3] is `tx`."""
    numbers = 0 if tx is None else 12
    head = struct.pack("<11i", 0, 21, 4, 0, width, height, 9, 0, 0, numbers, 12)
    k = struct.pack("<9d", fx, 0, width / 2, 0, fx, height / 2, 0, 0, 1)
    p = (fx, 0, width / 2, tx or 0.0, 0, fx, height / 2, 0, 0, 0, 1, 0)
    k += struct.pack(f"<{numbers}d", *p[:numbers])
    return head + k + floats(0, 0, 1, 0, -1, 0, 0, 0, 0, -1, 0, 0)


def stereo(width: int = 64, height: int = 48, baseline: float | None = None) -> bytes:
    """A pair; without a baseline neither camera has a projection matrix."""
    left = mono(width, height, tx=None if baseline is None else 0.0)
    right = mono(width, height, tx=None if baseline is None else -60.0 * baseline)
    head = struct.pack("<10i", 0, 21, 4, 1, 0, 0, 0, 0, len(left), len(right))
    return head + left + right


def scan_info(kind: int, **changes: float) -> bytes:
    """76 bytes; the scanner sits a metre above the base."""
    values = {"range_min": 0.1, "range_max": 30.0, "amin": 0.0, "amax": 0.0, "step": 0.0}
    values |= changes
    mount = (1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 1)
    return floats(kind, *values.values(), 100, *mount)
