"""Whole arrays in double precision, one row each, by name and the stage that wrote them."""

from __future__ import annotations

import json
import math
import zlib
from typing import Any

import numpy as np
from numpy.typing import NDArray

from formats.database.blobs import FAST, inflate
from formats.database.connection import Connection
from formats.nested_text import json_from_text
from mapmyworld.errors import MapError

_NONE = "none"
_TYPES = {"|i1", "|u1", *(f"<{kind}{size}" for kind in "iuf" for size in (2, 4, 8))}


def write_array(db: Connection, name: str, rank: int, array: NDArray[Any] | None) -> None:
    """Keeps `array` (...) as what the stage of this rank wrote under `name`.

    What later stages wrote is dropped. None is kept as well: it hides what earlier stages wrote.
    """
    db.run("DELETE FROM mapmyworld_arrays WHERE name = ? AND rank >= ?", (name, rank))
    insert = "INSERT INTO mapmyworld_arrays VALUES (?,?,?,?,?)"
    if array is None:
        db.run(insert, (name, rank, _NONE, _NONE, b""))
        return
    little = np.ascontiguousarray(array, array.dtype.newbyteorder("<"))
    data = zlib.compress(little.tobytes(), FAST)
    shape = json.dumps(list(array.shape))
    db.run(insert, (name, rank, little.dtype.str, shape, data))


def read_array(db: Connection, name: str, kind: str, shape: tuple[int, ...]) -> NDArray[Any] | None:
    """What the latest stage wrote under `name` (...); None where none did.

    Raises `MapError` unless it is of that kind ("i", "u" or "f") and shape; -1 is any length.
    """
    query = "SELECT dtype, shape, data FROM mapmyworld_arrays WHERE name = ? ORDER BY rank DESC"
    row = db.row(query, (name,))
    if row is None or row[0] == _NONE:
        return None
    try:
        if row[0] not in _TYPES:
            raise ValueError(f"of type {row[0]!r}")
        dtype, sides = np.dtype(row[0]), tuple(json_from_text(row[1]))
        fits = len(sides) == len(shape) and all(
            found == wanted or wanted < 0 <= found
            for found, wanted in zip(sides, shape, strict=True)
        )
        if dtype.kind != kind or not fits:
            raise ValueError(f"{dtype} of shape {row[1]}")
        size = dtype.itemsize * math.prod(sides)
        return np.frombuffer(inflate(row[2], size, name), dtype).reshape(sides)
    except (ValueError, TypeError) as error:
        raise MapError(f"{db.path}: {name}: a damaged array ({error})") from None


def check_lengths(db: Connection, what: str, *arrays: NDArray[Any] | None) -> None:
    """Raises `MapError` unless these arrays (N, ...), those that are there, have as many rows."""
    lengths = {len(array) for array in arrays if array is not None}
    if len(lengths) > 1:
        reported = ", ".join(map(str, sorted(lengths)))
        raise MapError(f"{db.path}: {what}: damaged arrays (of {reported} rows)")
