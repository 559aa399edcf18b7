"""A map of ours as a file: written while the log streams, read by everything that comes later."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager

import numpy as np
from numpy.typing import NDArray

from formats.database import results
from formats.database.arrays import check_lengths
from formats.database.connection import Connection
from formats.database.graph_tables import GraphTables
from formats.database.node_rows import StorageOptions
from formats.database.node_tables import NodeTables
from formats.database.result_tables import ResultTables
from formats.database.stage_tables import clear_from, rank_of
from mapmyworld.types.seams import STAGE_RANKS


class DatabaseStore(NodeTables, GraphTables, ResultTables):
    """The MapStore of a `map.db`."""

    def __init__(self, connection: Connection, options: StorageOptions) -> None:
        super().__init__(connection, options)
        self._compact = connection.writable and results.is_unpacked(connection)

    @property
    def problems(self) -> tuple[str, ...]:
        """What could not be read and was left out, one line each."""
        return ()

    def close(self) -> None:
        """Writes what is pending; after a stage was written, packs the file (see `compact`)."""
        if self._db.writable:
            self._db.commit()
        super().close()
        if self._compact:
            results.compact(self._db.path)

    def stage_done(self, stage: str, inputs: str | None) -> bool:
        found = self._db.row("SELECT inputs FROM mapmyworld_stages WHERE stage = ?", (stage,))
        return found is not None and inputs in (None, found[0])

    @contextmanager
    def write_stage(self, stage: str, inputs: str) -> Iterator[None]:
        rank = rank_of(stage)
        self._begin()
        if rank <= STAGE_RANKS["track"]:
            self._nodes = None
        if clear_from(self._db, rank):
            self._forget_constraints()
        with self.extend_stage(stage, inputs):
            yield

    @contextmanager
    def extend_stage(self, stage: str, inputs: str) -> Iterator[None]:
        rank = rank_of(stage)
        self._begin()
        self._restore_session()
        results.mark_unpacked(self._db)
        self._rank, self._compact = rank, False
        try:
            yield
            self._begin()
            if rank == STAGE_RANKS["track"]:
                results.write_parameters(self._db, results.sensor_parameters(self._db))
            self._compact = True
            record = "INSERT OR REPLACE INTO mapmyworld_stages VALUES (?,?,?)"
            self._db.run(record, (stage, rank, inputs))
        finally:
            self._rank = None
            self._db.commit()

    def frame_poses(self) -> NDArray[np.float64] | None:
        """(N, 4, 4) map_from_frame of all tracked frames; None before they are known."""
        poses = super().frame_poses()
        if poses is not None:
            check_lengths(self._db, "frame poses", poses, self.tracked_frames().stamps_ns)
        return poses
