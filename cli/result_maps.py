"""Maps that result from others: made beside the file they will be, and put there at the end."""

from __future__ import annotations

import os
import shutil
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING

from cli.storing import storage_arguments

if TYPE_CHECKING:
    from mapmyworld.config import Config
    from mapmyworld.types import MapStore


class ResultMaps:
    """The maps in the making beside OUTPUT; gone unless they are put in its place."""

    def __init__(self, output: Path, config: Config) -> None:
        self._output, self._stored = output, storage_arguments(config)
        self._written: list[Path] = []

    def __enter__(self) -> ResultMaps:
        return self

    def __exit__(self, *_: object) -> None:
        self.discard()

    def discard(self) -> None:
        """Removes what was written."""
        for path in self._written:
            path.unlink(missing_ok=True)
        self._written = []

    @contextmanager
    def open(self, _number: int = 0) -> Iterator[MapStore]:
        """The next map, empty."""
        from formats.database import open_store

        path = self._next()
        with open_store(path, create=True, overwrite=True, **self._stored) as store:
            yield store

    @contextmanager
    def copy_of_output(self) -> Iterator[MapStore]:
        """OUTPUT as it was, to be extended."""
        from formats.database import open_store

        open_store(self._output, read_only=True).close()  # refuses what is no map
        path = self._next()
        shutil.copyfile(self._output, path)
        with open_store(path, **self._stored) as store:
            yield store

    def _next(self) -> Path:
        path = numbered(self._output, len(self._written))
        self._written.append(path.with_name(f".{path.name}.part"))
        return self._written[-1]

    def put_in_place(self) -> None:
        """Gives the finished files their names."""
        for number, path in enumerate(self._written):
            os.replace(path, numbered(self._output, number))


def numbered(output: Path, number: int) -> Path:
    """OUTPUT for the first map, OUTPUT_2 for the second, ..."""
    return output if number == 0 else output.with_stem(f"{output.stem}_{number + 1}")
