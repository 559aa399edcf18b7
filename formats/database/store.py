"""A map of ours as a file: written while the log streams, read by everything that comes later."""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from types import TracebackType
from typing import Any

import numpy as np
from numpy.typing import NDArray

from formats.database import features as feature_rows
from formats.database import frame_rows, links, results
from formats.database import node_rows as rows
from formats.database.arrays import read_array, write_array
from formats.database.connection import Connection
from formats.database.node_rows import StorageOptions
from formats.database.scans import scan_to_blob
from formats.database.schema import STAGE_RANKS
from formats.database.stages import REPLACED, clear_from, rank_of
from formats.database.statistics import INSERT_STATISTICS, statistics_rows
from mapmyworld.errors import MapError
from mapmyworld.types import (
    Constraint,
    Features,
    Mesh,
    Node,
    NodeData,
    OccupancyGrid,
    PointCloud,
    Poses,
    Scan,
    TrackedFrames,
)

# Rows written between two commits: what a killed build loses at most.
_BATCH_NODES = 200
_BATCH_SCANS = 2000
_OUTSIDE = -1  # rank of keys put outside any stage; no stage clears them


class DatabaseStore:
    """The MapStore of a `map.db`."""

    def __init__(self, connection: Connection, options: StorageOptions) -> None:
        self._db = connection
        self._options = options
        self._rank: int | None = None
        self._scans: list[tuple[int, bytes]] = []
        self._uncommitted_nodes = 0
        self._uncommitted_scans = 0
        self._previous: dict[int, Node] = {}
        self._last_with_cells: Node | None = None
        self._compact = False
        self._solved_anew = False
        self._restore_session()
        self._constraints: tuple[Constraint, ...] | None = None

    @property
    def path(self) -> Path:
        return self._db.path

    @property
    def problems(self) -> tuple[str, ...]:
        """What could not be read and was left out, one line each."""
        return ()

    def __enter__(self) -> DatabaseStore:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self.close()

    def close(self) -> None:
        """Writes what is pending; after a stage was written, packs the file (see `compact`)."""
        if self._db.writable:
            self._flush()
            self._db.commit()
        self._db.close()
        if self._compact:
            results.compact(self._db.path)

    # Stages

    def stage_done(self, stage: str, inputs: str) -> bool:
        found = self._db.row("SELECT inputs FROM mapmyworld_stages WHERE stage = ?", (stage,))
        return found is not None and found[0] == inputs

    @contextmanager
    def write_stage(self, stage: str, inputs: str) -> Iterator[None]:
        rank = rank_of(stage)
        self._begin()
        self._constraints = None
        if clear_from(self._db, rank):
            self._rewrite_links()
        self._restore_session()
        self._rank, self._compact = rank, False
        try:
            yield
            self._begin()
            self._tell_rtabmap(rank)
            self._compact = True
            record = "INSERT OR REPLACE INTO mapmyworld_stages VALUES (?,?,?)"
            self._db.run(record, (stage, rank, inputs))
        finally:
            self._rank = None
            self._flush()
            self._db.commit()

    def get(self, key: str) -> Any:
        found = self._db.row(
            "SELECT value FROM mapmyworld_keys WHERE key = ? ORDER BY rank DESC", (key,)
        )
        return None if found is None else json.loads(found[0])

    def put(self, key: str, value: Any) -> None:
        rank = _OUTSIDE if self._rank is None else self._rank
        text = json.dumps(value, default=_plain)
        found = self._db.rows("SELECT rank, value FROM mapmyworld_keys WHERE key = ?", (key,))
        if found == [(rank, text)]:
            return  # a file in which nothing is new keeps its bytes
        self._begin()
        if self._rank is None:
            self._db.run("DELETE FROM mapmyworld_keys WHERE key = ?", (key,))
        self._db.run("INSERT OR REPLACE INTO mapmyworld_keys VALUES (?,?,?)", (key, rank, text))
        self._settle()

    # Nodes and their data

    def add_node(self, node: Node, data: NodeData) -> None:
        self._begin()
        if not self._previous:
            self._db.set_clock(node.stamp_ns)
        before = self._previous.get(node.session)
        self._db.run(rows.INSERT_NODE, rows.node_row(node, before))
        self._db.run(rows.INSERT_OWN, rows.own_row(node, data))
        with_cells = rows.wants_cells(node, self._last_with_cells, self._options)
        self._last_with_cells = node if with_cells else self._last_with_cells
        from formats.database import data_rows

        data_row = data_rows.data_row(node.id, data, self._options, with_cells=with_cells)
        if data_row is not None:
            self._db.run(data_rows.INSERT_DATA, data_row)
        if data.features is not None:
            self.set_features(node.id, data.features)
        self._previous[node.session] = node
        self._uncommitted_nodes += 1
        self._settle()

    def nodes(self) -> tuple[Node, ...]:
        found = self._db.rows(f"{rows.SELECT_OWN} ORDER BY id")
        return tuple(rows.node_from_own_row(row) for row in found)

    def node_data(self, node_id: int) -> NodeData:
        own = self._db.row(
            "SELECT stamp_ns, scan_rest, image_stamps, cloud FROM mapmyworld_nodes WHERE id = ?",
            (node_id,),
        )
        if own is None:
            raise MapError(f"{self.path}: there is no node {node_id}")
        from formats.database import data_rows

        row = self._db.row(data_rows.SELECT_DATA, (node_id,)) or (None,) * 5
        what = f"{self.path}: node {node_id}"
        data = data_rows.node_data(row, own[1:], own[0], what)
        found = self._db.rows(feature_rows.SELECT_FEATURES, (node_id,))
        features = feature_rows.features_from_rows(found, what)
        return NodeData(data.scan, data.images, data.cloud, features)

    def contents(self) -> dict[int, dict[str, int]]:
        """What each node keeps: counts of images, depth, scan, cloud; no blob is read."""
        found = self._db.rows("SELECT id, contents FROM mapmyworld_nodes ORDER BY id")
        return {node_id: json.loads(text) for node_id, text in found}

    # Scans of all tracked frames

    def add_scan(self, frame: int, scan: Scan) -> None:
        self._scans.append((frame, scan_to_blob(scan)))
        self._uncommitted_scans += 1
        if len(self._scans) >= frame_rows.SCANS_AT_ONCE:
            self._flush()
        self._settle()

    def scans(self, frames: Sequence[int] | NDArray[np.int64]) -> Iterator[tuple[int, Scan]]:
        self._flush()
        yield from frame_rows.read_scans(self._db, frames)

    def scan_count(self) -> int:
        """How many frames have a scan."""
        self._flush()
        return int(self._db.row("SELECT COUNT(*) FROM mapmyworld_scans")[0])

    def set_tracked_frames(self, frames: TrackedFrames) -> None:
        self._begin()
        frame_rows.write_frames(self._db, self._current_rank(), frames)
        self._settle()

    def tracked_frames(self) -> TrackedFrames:
        return frame_rows.read_frames(self._db) or frame_rows.nodes_as_frames(self.nodes())

    # The graph

    def add_constraints(self, constraints: Sequence[Constraint]) -> None:
        self._begin()
        self._constraints = None
        written = links.constraint_rows(constraints, self._current_rank())
        self._db.run_many(links.INSERT_CONSTRAINT, written)
        self._db.run_many(links.INSERT_LINK, links.link_rows(constraints))
        self._settle()

    def replace_constraints(self, constraints: Sequence[Constraint]) -> None:
        self._begin()
        self._constraints = None
        rank = self._current_rank()
        # Those of earlier stages stay, out of sight, for when this stage is done again.
        self._db.run("DELETE FROM mapmyworld_constraints WHERE rank >= ?", (rank,))
        self._db.run_many(links.INSERT_CONSTRAINT, links.constraint_rows(constraints, rank))
        mark = "INSERT OR REPLACE INTO mapmyworld_keys VALUES (?,?,'true')"
        self._db.run(mark, (REPLACED, rank))
        self._rewrite_links()
        self._solved_anew = True
        self._settle()

    def constraints(self) -> tuple[Constraint, ...]:
        if self._constraints is None:
            self._constraints = self._read_constraints()
        return self._constraints

    def _read_constraints(self) -> tuple[Constraint, ...]:
        newest = "SELECT MAX(rank) FROM mapmyworld_keys WHERE key = ?"
        (rank,) = self._db.row(newest, (REPLACED,))
        found = self._db.rows(links.SELECT_CONSTRAINTS, (_OUTSIDE if rank is None else rank,))
        return tuple(links.constraint_from_row(row) for row in found)

    def _rewrite_links(self) -> None:
        self._db.run("DELETE FROM Link")
        self._db.run_many(links.INSERT_LINK, links.link_rows(self.constraints()))

    # Features and words

    def set_features(self, node_id: int, features: Features) -> None:
        self._begin()
        # The stage that first wrote them keeps them: a later one only adds words.
        self._db.run(
            "INSERT INTO mapmyworld_features VALUES (?,?,?)"
            " ON CONFLICT (node_id) DO UPDATE SET count = excluded.count",
            (node_id, self._current_rank(), len(features.pixels)),
        )
        self._db.run("DELETE FROM Feature WHERE node_id = ?", (node_id,))
        written = feature_rows.feature_rows(node_id, features)
        self._db.run_many(feature_rows.INSERT_FEATURE, written)
        self._settle()

    def set_words(self, words: Mapping[int, NDArray[Any]]) -> None:
        self._begin()
        self._db.run("DELETE FROM Word")
        self._db.run_many(feature_rows.INSERT_WORD, feature_rows.word_rows(words))
        self._db.run("UPDATE Info SET dictionary_size = ?", (len(words),))
        self._settle()

    def words(self) -> dict[int, NDArray[Any]]:
        found = self._db.rows(feature_rows.SELECT_WORDS)
        what = f"{self.path}: word"
        return {
            word_id: feature_rows.descriptor_from_blob(size, blob, f"{what} {word_id}")
            for word_id, size, blob in found
        }

    # Results

    def set_poses(self, poses: Poses) -> None:
        self._begin()
        self._write("poses ids", poses.ids)
        self._write("poses map_from_node", poses.map_from_node)
        self._write("poses covariances", poses.covariances)
        results.write_poses(self._db, poses)
        self._solved_anew = True
        self._settle()

    def poses(self) -> Poses | None:
        ids, solved = self._read("poses ids"), self._read("poses map_from_node")
        if ids is None or solved is None:
            return None
        return Poses(ids, solved, self._read("poses covariances"))

    def set_frame_poses(self, map_from_frame: NDArray[np.float64]) -> None:
        self._begin()
        self._write("frame poses", map_from_frame)
        self._settle()

    def frame_poses(self) -> NDArray[np.float64] | None:
        return self._read("frame poses")

    def set_grid(self, grid: OccupancyGrid) -> None:
        self._begin()
        self._write("grid log_odds", grid.log_odds)
        figures = [grid.resolution, *grid.origin, grid.occupied_threshold, grid.free_threshold]
        self._write("grid figures", np.array(figures, np.float64))
        results.write_grid(self._db, grid)
        self._settle()

    def grid(self) -> OccupancyGrid | None:
        log_odds, figures = self._read("grid log_odds"), self._read("grid figures")
        if log_odds is None or figures is None:
            return None
        resolution, x, y, occupied, free = (float(value) for value in figures)
        return OccupancyGrid(log_odds, resolution, np.array([x, y]), occupied, free)

    # What only RTAB-Map's tools read

    def set_parameters(self, parameters: Mapping[str, str]) -> None:
        """Adds to how the map was made, in RTAB-Map's parameter names."""
        self._begin()
        results.write_parameters(self._db, parameters)
        self._settle()

    def set_cloud(self, cloud: PointCloud) -> None:
        """The cloud that RTAB-Map's viewer shows of the map as a whole."""
        self._begin()
        results.write_cloud(self._db, cloud)
        self._settle()

    def set_mesh(self, mesh: Mesh) -> None:
        """The mesh that RTAB-Map's viewer shows of the map as a whole."""
        self._begin()
        results.write_mesh(self._db, mesh)
        self._settle()

    def parameters(self) -> dict[str, str]:
        """How the map was made, in RTAB-Map's parameter names."""
        return results.read_parameters(self._db)

    def _tell_rtabmap(self, rank: int) -> None:
        """At the end of a stage, what follows from it under RTAB-Map's names."""
        if rank == STAGE_RANKS["track"]:
            results.write_parameters(self._db, results.sensor_parameters(self._db))
        if rank >= STAGE_RANKS["recognise"] and self._solved_anew:
            self._solved_anew = False
            self._write_statistics()

    def _write_statistics(self) -> None:
        poses = self.poses()
        if poses is None:
            return
        counts = dict(self._db.rows("SELECT node_id, count FROM mapmyworld_features"))
        (words,) = self._db.row("SELECT COUNT(*) FROM Word")
        figures = statistics_rows(self.nodes(), self.constraints(), poses, counts, words)
        self._db.run("DELETE FROM Statistics")
        self._db.run_many(INSERT_STATISTICS, figures)

    # How rows are written

    def _current_rank(self) -> int:
        """Of the stage being written, else of the last one done."""
        if self._rank is not None:
            return self._rank
        (rank,) = self._db.row("SELECT MAX(rank) FROM mapmyworld_stages")
        return 0 if rank is None else int(rank)

    def _write(self, name: str, array: NDArray[Any] | None) -> None:
        write_array(self._db, name, self._current_rank(), array)

    def _read(self, name: str) -> NDArray[Any] | None:
        return read_array(self._db, name)

    def _begin(self) -> None:
        if not self._db.writable:
            raise MapError(f"{self.path}: was opened for reading only")
        self._db.begin()

    def _flush(self) -> None:
        if self._scans:
            self._begin()
            pending, self._scans = self._scans, []
            self._db.run_many(frame_rows.INSERT_SCAN, pending)

    def _settle(self) -> None:
        """Commits: outside a stage at once, inside one a batch of nodes at a time."""
        full = self._uncommitted_nodes >= _BATCH_NODES or self._uncommitted_scans >= _BATCH_SCANS
        if self._rank is None or full:
            self._flush()
            self._db.commit()
            self._uncommitted_nodes = self._uncommitted_scans = 0

    def _restore_session(self) -> None:
        """Takes up where the file stands: the last node of each session, the log's clock."""
        last = (
            f"{rows.SELECT_OWN} WHERE id IN (SELECT MAX(id) FROM mapmyworld_nodes GROUP BY session)"
        )
        nodes = [rows.node_from_own_row(row) for row in self._db.rows(last)]
        self._previous = {node.session: node for node in nodes}
        self._last_with_cells = None
        first = self._db.row("SELECT stamp_ns FROM mapmyworld_nodes ORDER BY id LIMIT 1")
        if first is not None:
            self._db.set_clock(first[0])


def _plain(value: Any) -> Any:
    """Numpy's numbers and arrays, as JSON knows them."""
    if isinstance(value, np.generic | np.ndarray):
        return value.tolist()
    return str(value)
