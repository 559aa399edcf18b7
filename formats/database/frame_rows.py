"""What is kept of every tracked frame: its place in time and on its node, and its scan."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np
from numpy.typing import NDArray

from formats.database.arrays import check_lengths, read_array, write_array
from formats.database.connection import Connection
from formats.database.scan_blobs import blob_to_scan
from mapmyworld.types import Scan, TrackedFrames

INSERT_SCAN = "INSERT OR REPLACE INTO mapmyworld_scans VALUES (?,?)"
SCANS_AT_ONCE = 256  # held in memory, written and read together


def write_frames(db: Connection, rank: int, frames: TrackedFrames) -> None:
    """The arrays of all tracked frames."""
    write_array(db, "tracked stamps_ns", rank, frames.stamps_ns)
    write_array(db, "tracked node_ids", rank, frames.node_ids)
    write_array(db, "tracked node_from_frame", rank, frames.node_from_frame)
    write_array(db, "tracked is_node", rank, np.asarray(frames.is_node, np.uint8))
    write_array(db, "tracked odom_from_base", rank, frames.odom_from_base)


def read_frames(db: Connection) -> TrackedFrames | None:
    """The arrays of `write_frames`; None where tracking did not come to its end."""
    stamps = read_array(db, "tracked stamps_ns", "i", (-1,))
    node_ids = read_array(db, "tracked node_ids", "i", (-1,))
    motions = read_array(db, "tracked node_from_frame", "f", (-1, 4, 4))
    is_node = read_array(db, "tracked is_node", "u", (-1,))
    if stamps is None or node_ids is None or motions is None or is_node is None:
        return None
    odometry = read_array(db, "tracked odom_from_base", "f", (-1, 4, 4))
    check_lengths(db, "tracked frames", stamps, node_ids, motions, is_node, odometry)
    return TrackedFrames(stamps, node_ids, motions, is_node.astype(np.bool_), odometry)


def read_scans(
    db: Connection, frames: Sequence[int] | NDArray[np.int64]
) -> Iterator[tuple[int, Scan]]:
    """The scans of these frames (K,), ascending; read a few hundred at a time."""
    wanted = np.unique(np.asarray(frames, np.int64))
    for start in range(0, len(wanted), SCANS_AT_ONCE):
        chunk = wanted[start : start + SCANS_AT_ONCE].tolist()
        for frame, blob in _scan_blobs(db, chunk):
            yield frame, blob_to_scan(blob, f"{db.path}: scan {frame}")


def _scan_blobs(db: Connection, frames: list[int]) -> list[tuple[int, bytes]]:
    """Rows of these frames, ascending; a gapless run is read as a range."""
    if frames[-1] - frames[0] == len(frames) - 1:
        where, values = "BETWEEN ? AND ?", [frames[0], frames[-1]]
    else:
        where, values = f"IN ({','.join('?' * len(frames))})", frames
    query = f"SELECT frame, scan FROM mapmyworld_scans WHERE frame {where} ORDER BY frame"
    return db.rows(query, values)
