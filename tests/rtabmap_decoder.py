"""RTAB-Map's database decoded by its description alone, sharing no code with our writer.

Struct, zlib and a PNG/JPEG decoder; numbers of sections are those of the description of the
format by which the writer was made.
"""

from __future__ import annotations

import sqlite3
import struct
import zlib
from pathlib import Path
from typing import Any

import cv2
import numpy as np

CV_TYPES = {0: "u1", 1: "i1", 2: "<u2", 3: "<i2", 4: "<i4", 5: "<f4", 6: "<f8"}


def matrix(blob: bytes) -> np.ndarray:
    """4.1: a zlib stream, then rows, columns and OpenCV's type."""
    rows, cols, cv_type = struct.unpack("<3i", blob[-12:])
    raw = zlib.decompressobj().decompress(blob[:-12])
    channels = cv_type // 8 + 1
    return np.frombuffer(raw, CV_TYPES[cv_type % 8]).reshape(rows, cols, channels)


def transform(blob: bytes) -> np.ndarray:
    """4.2: twelve floats, row by row."""
    assert len(blob) == 48
    floats = struct.unpack("<12f", blob)
    return np.array([floats[0:4], floats[4:8], floats[8:12], (0, 0, 0, 1)])


def information(blob: bytes) -> np.ndarray:
    """3.4: x y z roll pitch yaw."""
    assert len(blob) == 288
    return np.array(struct.unpack("<36d", blob)).reshape(6, 6)


def depth_metres(blob: bytes) -> np.ndarray:
    """4.4: RVL, 16-bit PNG in millimetres, or float32 in the bytes of a four-channel PNG."""
    if blob[:8] == b"DEPTHRVL":
        cols, rows = struct.unpack("<2I", blob[8:16])
        return np.array(rvl(blob[16:], rows * cols)).reshape(rows, cols) * 1e-3
    pixels = cv2.imdecode(np.frombuffer(blob, np.uint8), cv2.IMREAD_UNCHANGED)
    if pixels.dtype == np.uint16:
        return pixels * 1e-3
    assert pixels.dtype == np.uint8
    assert pixels.shape[2] == 4
    return np.frombuffer(pixels.tobytes(), "<f4").reshape(pixels.shape[:2])


def rvl_words(depth: np.ndarray) -> bytes:
    """Wilson's coder, nibble by nibble, after the paper."""
    nibbles: list[int] = []

    def put(value: int) -> None:
        while True:
            value, low = value >> 3, value & 7
            nibbles.append(low | (8 if value else 0))
            if not value:
                return

    flat, previous, at = depth.reshape(-1).astype(int), 0, 0
    while at < len(flat):
        start = at
        while at < len(flat) and flat[at] == 0:
            at += 1
        put(at - start)
        start = at
        while at < len(flat) and flat[at] != 0:
            at += 1
        put(at - start)
        for value in flat[start:at]:
            delta = value - previous
            put((delta << 1) ^ (delta >> 31))
            previous = value
    nibbles += [0] * (-len(nibbles) % 8)
    words = [
        int("".join(f"{n:x}" for n in nibbles[i : i + 8]), 16) for i in range(0, len(nibbles), 8)
    ]
    return struct.pack(f"<{len(words)}I", *words)


def rvl(words: bytes, count: int) -> list[int]:
    """4.4.1, a nibble at a time."""
    nibbles = iter(
        word >> shift & 15
        for (word,) in struct.iter_unpack("<I", words)
        for shift in range(28, -4, -4)
    )

    def number() -> int:
        value, shift = 0, 0
        while True:
            nibble = next(nibbles)
            value |= (nibble & 7) << shift
            shift += 3
            if nibble < 8:
                return value

    pixels: list[int] = []
    previous = 0
    while len(pixels) < count:
        pixels += [0] * number()
        for _ in range(number()):
            zigzag = number()
            previous += (zigzag >> 1) ^ -(zigzag & 1)
            pixels.append(previous)
    return pixels


def picture(blob: bytes) -> np.ndarray:
    """4.3: an image file; RGB."""
    pixels = cv2.imdecode(np.frombuffer(blob, np.uint8), cv2.IMREAD_UNCHANGED)
    return pixels if pixels.ndim == 2 else pixels[..., ::-1]


def calibrations(blob: bytes) -> list[dict[str, Any]]:
    """4.5, mono records only; every byte must be used."""
    found = []
    while blob:
        head = struct.unpack("<11i", blob[:44])
        assert head[3] == 0
        at, record = 44, {"size": head[4:6]}
        for name, count in zip("KDRP", head[6:10], strict=True):
            record[name] = np.array(struct.unpack(f"<{count}d", blob[at : at + 8 * count]))
            at += 8 * count
        assert head[10] == 12
        record["L"] = transform(blob[at : at + 48])
        found.append(record)
        blob = blob[at + 48 :]
    return found


def scan_info(blob: bytes) -> dict[str, Any]:
    """4.7: 19 floats."""
    assert len(blob) == 76
    values = struct.unpack("<19f", blob)
    names = ("format", "range_min", "range_max", "angle_min", "angle_max", "increment", "most")
    return dict(zip(names, values, strict=False)) | {"mount": transform(blob[28:])}


class Decoder:
    """Rows of a database as dictionaries, blobs still as they are."""

    def __init__(self, path: Path) -> None:
        self.sqlite = sqlite3.connect(f"file:{path}?mode=ro", uri=True)
        self.sqlite.row_factory = sqlite3.Row

    def rows(self, table: str, order: str = "rowid") -> list[dict[str, Any]]:
        found = self.sqlite.execute(f"SELECT * FROM {table} ORDER BY {order}")
        return [dict(row) for row in found]

    def only(self, table: str) -> dict[str, Any]:
        (row,) = self.rows(table)
        return row

    def close(self) -> None:
        self.sqlite.close()

    def optimised(self) -> dict[int, np.ndarray]:
        """2.9: id -> map_from_base."""
        admin = self.only("Admin")
        ids = matrix(admin["opt_ids"])
        poses = matrix(admin["opt_poses"])
        assert ids.dtype == np.int32
        assert poses.dtype == np.float32
        assert ids.shape[0] == poses.shape[0] == 1
        rows = poses.reshape(-1, 12)
        return {int(i): transform(row.tobytes()) for i, row in zip(ids.ravel(), rows, strict=True)}

    def parameters(self) -> dict[str, str]:
        """2.7: the newest row, split at ";" and at the first ":"."""
        newest = max(self.rows("Info"), key=lambda row: row["time_enter"])
        return dict(part.split(":", 1) for part in newest["parameters"].split(";"))
