"""How rows of a map of ours are written: in batches, each with the stage that wrote it."""

from __future__ import annotations

import json
from typing import Any

import numpy as np
from numpy.typing import NDArray

from formats.database.arrays import read_array, write_array
from formats.database.connection import Connection, Opened
from formats.nested_text import json_from_text
from mapmyworld.errors import MapError

# Nodes and scans written between two commits: what a killed build loses at most.
_BATCH = {"nodes": 200, "scans": 2000}
_OUTSIDE = -1  # rank of keys put outside any stage; no stage clears them


class Transactions(Opened):
    """The stage in hand, and values and arrays kept by name and stage."""

    def __init__(self, connection: Connection) -> None:
        super().__init__(connection)
        self._rank: int | None = None
        self._uncommitted = dict.fromkeys(_BATCH, 0)

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
        write_array(self._db, name, self._current_rank(), array)

    def _read(self, name: str, kind: str, shape: tuple[int, ...]) -> NDArray[Any] | None:
        return read_array(self._db, name, kind, shape)

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

    def _commit(self, written: str = "") -> None:
        """Commits: outside a stage at once, inside one a batch at a time."""
        if written:
            self._uncommitted[written] += 1
        full = any(self._uncommitted[name] >= most for name, most in _BATCH.items())
        if self._rank is None or full:
            self._db.commit()
            self._uncommitted = dict.fromkeys(_BATCH, 0)


def _plain(value: Any) -> Any:
    """Numpy's numbers and arrays, as JSON knows them."""
    if isinstance(value, np.generic | np.ndarray):
        return value.tolist()
    return str(value)
