"""A map file held open, whoever wrote it."""

from __future__ import annotations

from pathlib import Path
from types import TracebackType
from typing import Self

from formats.database.connection import Connection


class Opened:
    """Closed at the end of a `with` block."""

    def __init__(self, connection: Connection) -> None:
        self._db = connection
        self.path: Path = connection.path

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self.close()

    def close(self) -> None:
        self._db.close()
