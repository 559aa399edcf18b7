"""Seeded damage to bytes: what broken disks, cut cables and ill will do to files."""

from __future__ import annotations

import re
import sqlite3
import struct
import zlib
from collections.abc import Callable
from contextlib import closing
from pathlib import Path

import numpy as np

Rng = np.random.Generator
Damage = Callable[[bytearray, Rng], bytearray]

_INTEGERS = (0, 1, 0x7F, 0x80, 0xFF, 0x7FFF, 0xFFFF, 0x7FFFFFFF, 0x80000000, 0xFFFFFFFF, 1 << 40,
             (1 << 63) - 1, 1 << 63, (1 << 64) - 1)  # fmt: skip
_FLOATS = (float("nan"), float("inf"), -float("inf"), 0.0, -1.0, 1e300, 1e-300, 1e38)
_WORDS = (b"nan", b"inf", b"-1", b"0", b"1e400", b"", b"99999999999999999999", b"-0.0", b"x",
          b"2147483648", b"../../etc/passwd", b"\xff\xfe", b"1 2", b"[1, 2", b"{}")  # fmt: skip


def mutated(data: bytes, seed: tuple[int, ...], *, text: bool = False) -> bytes:
    """The bytes with one to three kinds of damage; the same for the same seed."""
    rng = np.random.default_rng(seed)
    spoilt = bytearray(data)
    kinds = _IN_TEXT if text else _IN_BYTES
    for _ in range(int(rng.integers(1, 4))):
        spoilt = kinds[int(rng.integers(len(kinds)))](spoilt, rng)
    return bytes(spoilt)


def spoil_database(path: Path, seed: tuple[int, ...]) -> None:
    """Damages values in a sound SQLite file, so that they reach those who read them."""
    rng = np.random.default_rng(seed)
    with closing(sqlite3.connect(path)) as database, database:
        tables = database.execute("SELECT name FROM sqlite_master WHERE type = 'table'").fetchall()
        filled = [
            name for (name,) in tables
            if database.execute(f"SELECT COUNT(*) FROM \"{name}\"").fetchone()[0]
        ]  # fmt: skip
        for _ in range(int(rng.integers(1, 4))):
            _spoil_value(database, filled[int(rng.integers(len(filled)))], rng)


def _spoil_value(database: sqlite3.Connection, table: str, rng: Rng) -> None:
    """One value of a table made another one, or its row removed."""
    columns = [row[1] for row in database.execute(f'PRAGMA table_info("{table}")')]
    rows = [row for (row,) in database.execute(f'SELECT rowid FROM "{table}"')]
    if not rows:  # the last one was removed by the damage before
        return
    row, column = rows[int(rng.integers(len(rows)))], columns[int(rng.integers(len(columns)))]
    if rng.random() < 0.1:
        database.execute(f'DELETE FROM "{table}" WHERE rowid = ?', (row,))
        return
    where = f'FROM "{table}" WHERE rowid = ?'
    (value,) = database.execute(f'SELECT "{column}" {where}', (row,)).fetchone()
    try:
        update = f'UPDATE OR REPLACE "{table}" SET "{column}" = ? WHERE rowid = ?'
        database.execute(update, (_other_value(value, rng), row))
    except sqlite3.IntegrityError:
        return  # the file itself forbids it


def _other_value(value: object, rng: Rng) -> object:
    if rng.random() < 0.1:  # of another type
        return [None, "text", b"bytes", 1.5, -1][int(rng.integers(5))]
    if isinstance(value, bytes):
        return _other_bytes(value, rng)
    if isinstance(value, str):
        data = mutated(value.encode(), (int(rng.integers(1 << 31)),), text=True)
        return data.decode("utf-8", "replace")
    if isinstance(value, float):
        return _FLOATS[int(rng.integers(len(_FLOATS)))]
    number = _INTEGERS[int(rng.integers(len(_INTEGERS)))]
    return number if number < 1 << 63 else -1


def _other_bytes(value: bytes, rng: Rng) -> bytes:
    """Of packed ones as often what they hold, so that it reaches those who compute with it."""
    decoder = zlib.decompressobj()
    try:
        held = decoder.decompress(value) + decoder.flush()
    except zlib.error:
        held = b""
    if not held or rng.random() < 0.5:
        return mutated(value, (int(rng.integers(1 << 31)),))
    if rng.random() < 0.5 and len(held) >= 8:  # a number where one stood
        place = 8 * int(rng.integers(len(held) // 8))
        reported = struct.pack("<d", _FLOATS[int(rng.integers(len(_FLOATS)))])
        held = held[:place] + reported + held[place + 8 :]
    else:
        held = mutated(held, (int(rng.integers(1 << 31)),))
    return zlib.compress(held) + decoder.unused_data


def _flip(data: bytearray, rng: Rng) -> bytearray:
    for _ in range(int(rng.integers(1, 5)) if data else 0):
        data[int(rng.integers(len(data)))] = int(rng.integers(256))
    return data


def _bit(data: bytearray, rng: Rng) -> bytearray:
    if data:
        data[int(rng.integers(len(data)))] ^= 1 << int(rng.integers(8))
    return data


def _number(data: bytearray, rng: Rng) -> bytearray:
    """An extreme number over whatever stands there."""
    if rng.random() < 0.5:
        width = int(rng.choice([1, 2, 4, 8]))
        value = _INTEGERS[int(rng.integers(len(_INTEGERS)))]
        reported = (value & ((1 << 8 * width) - 1)).to_bytes(width, "little")
    else:
        kind = "<f" if rng.random() < 0.5 else "<d"
        with np.errstate(over="ignore"):
            value = float(np.float32(_FLOATS[int(rng.integers(len(_FLOATS)))]))
        reported = struct.pack(kind, value)
    place = int(rng.integers(max(len(data) - len(reported), 1)))
    data[place : place + len(reported)] = reported
    return data


def _cut(data: bytearray, rng: Rng) -> bytearray:
    return data[: int(rng.integers(len(data) + 1))]


def _gone(data: bytearray, rng: Rng) -> bytearray:
    start, end = _span(data, rng)
    del data[start:end]
    return data


def _twice(data: bytearray, rng: Rng) -> bytearray:
    start, end = _span(data, rng)
    return data[:end] + data[start:end] + data[end:]


def _zeroed(data: bytearray, rng: Rng) -> bytearray:
    start, end = _span(data, rng)
    data[start:end] = bytes(end - start)
    return data


def _noise(data: bytearray, rng: Rng) -> bytearray:
    place = int(rng.integers(len(data) + 1))
    return data[:place] + rng.bytes(int(rng.integers(1, 64))) + data[place:]


def _swapped(data: bytearray, rng: Rng) -> bytearray:
    start, end = _span(data, rng)
    middle = (start + end) // 2
    return data[:start] + data[middle:end] + data[start:middle] + data[end:]


def _span(data: bytearray, rng: Rng) -> tuple[int, int]:
    """A stretch, short as often as long."""
    start = int(rng.integers(len(data) + 1))
    length = int(2 ** rng.uniform(0, np.log2(len(data) + 2)))
    return start, min(start + length, len(data))


def _word(data: bytearray, rng: Rng) -> bytearray:
    """Another word where one stood."""
    words = list(re.finditer(rb"[^\s,\[\]]+", data))
    if words:
        found = words[int(rng.integers(len(words)))]
        data[found.start() : found.end()] = _WORDS[int(rng.integers(len(_WORDS)))]
    return data


def _line(data: bytearray, rng: Rng) -> bytearray:
    """A line removed, repeated or moved."""
    lines = data.split(b"\n")
    taken = lines.pop(int(rng.integers(len(lines))))
    for _ in range(int(rng.integers(3))):
        lines.insert(int(rng.integers(len(lines) + 1)), taken)
    return bytearray(b"\n").join(lines)


_IN_BYTES: tuple[Damage, ...] = (
    _flip, _flip, _bit, _number, _number, _number, _cut, _gone, _twice, _zeroed, _noise, _swapped,
)  # fmt: skip
_IN_TEXT: tuple[Damage, ...] = (
    _word,
    _word,
    _word,
    _word,
    _line,
    _line,
    _flip,
    _cut,
    _gone,
    _twice,
)
