"""How rows of a map of ours are written: each with the stage that wrote it."""

from __future__ import annotations

import json
import math
import zlib
from collections.abc import Iterator
from typing import Any

import numpy as np
from numpy.typing import NDArray

from formats.database.blobs import FAST, inflate
from formats.database.connection import Connection, Opened
from formats.nested_text import json_from_text
from mapmyworld.errors import MapError

_OUTSIDE = -1  # rank of keys put outside any stage; no stage clears them
_ROWS = 256  # of an array that are copied to be compressed
_NONE = "none"  # type and shape of an array that is none
_TYPES = {"|i1", "|u1", *(f"<{kind}{size}" for kind in "iuf" for size in (2, 4, 8))}


class Transactions(Opened):
    """The stage in hand, and values and arrays kept by name and stage."""

    def __init__(self, connection: Connection) -> None:
        super().__init__(connection)
        self._rank: int | None = None

    def get(self, key: str) -> Any:
        found = self._db.row(
            "SELECT value FROM mapmyworld_keys WHERE key = ? ORDER BY rank DESC", (key,)
        )
        try:
            return None if found is None else json_from_text(found[0])
        except (ValueError, TypeError) as error:
            raise MapError(f"{self.path}: {key}: a damaged value ({error})") from None

    def put(self, key: str, value: Any) -> None:
        rank = _OUTSIDE if self._rank is None else self._rank
        text = json.dumps(value, default=_plain)
        found = self._db.rows("SELECT rank, value FROM mapmyworld_keys WHERE key = ?", (key,))
        if found == [(rank, text)]:
            return  # a file in which nothing is new keeps its bytes
        self._begin()
        if self._rank is None and [known for known, _ in found] == [rank]:
            self._db.run("UPDATE mapmyworld_keys SET value = ? WHERE key = ?", (text, key))
            self._commit()  # the row stays where it is, as if nothing else had stood there
            return
        if self._rank is None:
            self._db.run("DELETE FROM mapmyworld_keys WHERE key = ?", (key,))
        self._db.run("INSERT OR REPLACE INTO mapmyworld_keys VALUES (?,?,?)", (key, rank, text))
        self._commit()

    def _write(self, name: str, array: NDArray[Any] | None) -> None:
        """Keeps `array` (...), in double precision, as what the stage in hand wrote under `name`.

        What later stages wrote is dropped. None is kept as well: it hides what earlier ones wrote.
        """
        rank = self._current_rank()
        self._db.run("DELETE FROM mapmyworld_arrays WHERE name = ? AND rank >= ?", (name, rank))
        row: tuple[Any, ...] = (_NONE, _NONE, b"")
        if array is not None:
            dtype = array.dtype.newbyteorder("<")
            row = (dtype.str, json.dumps(list(array.shape)), b"".join(_packed(array, dtype)))
        self._db.run("INSERT INTO mapmyworld_arrays VALUES (?,?,?,?,?)", (name, rank, *row))

    def _read(self, name: str, kind: str, shape: tuple[int, ...]) -> NDArray[Any] | None:
        """What the latest stage wrote under `name` (...); None where none did.

        Raises `MapError` unless it is of that kind ("i", "u" or "f") and shape; -1 is any length.
        """
        query = "SELECT dtype, shape, data FROM mapmyworld_arrays WHERE name = ? ORDER BY rank DESC"
        row = self._db.row(query, (name,))
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
            raise MapError(f"{self.path}: {name}: a damaged array ({error})") from None

    def _check_lengths(self, what: str, *arrays: NDArray[Any] | None) -> None:
        """Raises `MapError` unless the arrays (N, ...) that are there have as many rows."""
        lengths = {len(array) for array in arrays if array is not None}
        if len(lengths) > 1:
            reported = ", ".join(map(str, sorted(lengths)))
            raise MapError(f"{self.path}: {what}: damaged arrays (of {reported} rows)")

    def _current_rank(self) -> int:
        """Of the stage being written, else of the last one done."""
        if self._rank is not None:
            return self._rank
        (rank,) = self._db.row("SELECT MAX(rank) FROM mapmyworld_stages")
        return 0 if rank is None else int(rank)

    def _begin(self) -> None:
        if not self._db.writable:
            raise MapError(f"{self.path}: was opened for reading only")
        self._db.begin()

    def _commit(self) -> None:
        """Outside a stage; inside one its end commits, and nodes do so a batch at a time."""
        if self._rank is None:
            self._db.commit()


def _packed(array: NDArray[Any], dtype: np.dtype[Any]) -> Iterator[bytes]:
    """The compressed rows of an array (N, ...), of which some at a time are copied."""
    packer = zlib.compressobj(FAST)
    for first in range(0, len(array), _ROWS):
        yield packer.compress(np.ascontiguousarray(array[first : first + _ROWS], dtype).data)
    yield packer.flush()


def _plain(value: Any) -> Any:
    """Numpy's numbers and arrays, as JSON knows them."""
    if isinstance(value, np.generic | np.ndarray):
        return value.tolist()
    return str(value)
