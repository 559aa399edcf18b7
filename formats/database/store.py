"""A map of ours as a file: written while the log streams, read by everything that comes later."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager

import numpy as np
from numpy.typing import NDArray

from formats.database import results
from formats.database.connection import Connection
from formats.database.graph_tables import GraphTables
from formats.database.node_rows import StorageOptions
from formats.database.node_tables import NodeTables
from formats.database.result_tables import ResultTables
from mapmyworld.errors import MapError
from mapmyworld.types.seams import STAGE_RANKS

_TRACK, _RECOGNISE, _OPTIMISE = (STAGE_RANKS[name] for name in ("track", "recognise", "optimise"))
_NODE_TABLES = (
    "GlobalDescriptor",
    "Feature",
    "Data",
    "Node",
    "mapmyworld_nodes",
    "mapmyworld_scans",
)


class DatabaseStore(NodeTables, GraphTables, ResultTables):
    """The MapStore of a `map.db`."""

    def __init__(self, connection: Connection, options: StorageOptions) -> None:
        super().__init__(connection, options)
        # By 1 the file says that a build wrote into it, and was stopped before it packed it.
        self._compact = connection.writable and bool(connection.row("PRAGMA user_version")[0])

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
        self._begin()
        self._clear_from(_rank_of(stage))
        with self.extend_stage(stage, inputs):
            yield

    @contextmanager
    def extend_stage(self, stage: str, inputs: str) -> Iterator[None]:
        rank = _rank_of(stage)
        self._begin()
        self._restore_session()
        self._db.run("PRAGMA user_version = 1")
        self._rank, self._compact = rank, False
        try:
            yield
            self._begin()
            if rank == _TRACK:
                results.write_parameters(self._db, results.sensor_parameters(self._db))
            self._compact = True
            record = "INSERT OR REPLACE INTO mapmyworld_stages VALUES (?,?,?)"
            self._db.run(record, (stage, rank, inputs))
        finally:
            self._rank = None
            self._db.commit()

    def _clear_from(self, rank: int) -> None:
        """Deletes what stages of this rank and later wrote."""
        db = self._db
        judged = db.row(
            "SELECT EXISTS (SELECT 1 FROM mapmyworld_constraints WHERE rank >= ?)"
            " OR EXISTS (SELECT 1 FROM mapmyworld_verdicts WHERE rank >= ?)",
            (rank, rank),
        )
        for table in ("stages", "keys", "arrays", "constraints", "verdicts"):
            db.run(f"DELETE FROM mapmyworld_{table} WHERE rank >= ?", (rank,))
        if rank <= _TRACK:
            self._nodes = None
            for table in _NODE_TABLES:
                db.run(f"DELETE FROM {table}")
        if rank <= _RECOGNISE:  # features that were there before lose their words, the rest go
            later = "(SELECT node_id FROM mapmyworld_features WHERE rank >= ?)"
            db.run("DELETE FROM Word")
            db.run(f"DELETE FROM Feature WHERE node_id IN {later}", (rank,))
            db.run("UPDATE Feature SET word_id = -rowid WHERE word_id > 0")
            db.run("DELETE FROM mapmyworld_features WHERE rank >= ?", (rank,))
            db.run("UPDATE Info SET dictionary_size = 0")
        if rank <= _OPTIMISE:
            db.run(
                "UPDATE Admin SET opt_ids = NULL, opt_poses = NULL, opt_last_localization = NULL"
            )
        db.run(
            "UPDATE Admin SET opt_map = NULL, opt_map_x_min = NULL, opt_map_y_min = NULL,"
            " opt_map_resolution = NULL"
        )
        if judged[0]:
            self._forget_constraints()

    def frame_poses(self) -> NDArray[np.float64] | None:
        """(N, 4, 4) map_from_frame of all tracked frames; None before they are known."""
        poses = super().frame_poses()
        if poses is not None:
            self._check_lengths("frame poses", poses, self.tracked_frames().stamps_ns)
        return poses


def _rank_of(stage: str) -> int:
    """The stage's place in the order of the build; raises `MapError` for an unknown one."""
    if stage not in STAGE_RANKS:
        raise MapError(f"no stage is called {stage!r}: there are {', '.join(STAGE_RANKS)}")
    return STAGE_RANKS[stage]
