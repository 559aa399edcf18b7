"""The nodes of a map of ours, their data, and the scans of all tracked frames."""

from __future__ import annotations

import json
from collections.abc import Iterator, Sequence

import numpy as np
from numpy.typing import NDArray

from formats.database import data_rows, feature_rows
from formats.database import node_rows as rows
from formats.database.connection import Connection
from formats.database.node_rows import StorageOptions
from formats.database.scan_blobs import blob_to_scan, scan_to_blob
from formats.database.transactions import Transactions
from mapmyworld.errors import MapError
from mapmyworld.types import Features, Node, NodeData, Scan, TrackedFrames
from mapmyworld.types.frames import nodes_as_frames

_BATCH = 200  # nodes between two commits: what a killed build loses at most
# The stage that first wrote features keeps them: a later one only adds words.
_INSERT_STAGE = "INSERT OR IGNORE INTO mapmyworld_features VALUES (?,?)"


class NodeTables(Transactions):
    """Written while the log streams; a node's data are read without touching others'."""

    def __init__(self, connection: Connection, options: StorageOptions) -> None:
        super().__init__(connection)
        self._options = options
        self._nodes: tuple[Node, ...] | None = None
        self._previous: dict[int, Node] = {}
        self._restore_session()

    def add_node(self, node: Node, data: NodeData) -> None:
        self._begin()
        self._nodes = None
        if not self._previous:
            self._db.set_clock(node.stamp_ns)
        before = self._previous.get(node.session)
        self._db.run(rows.INSERT_NODE, rows.node_row(node, before))
        self._db.run(rows.INSERT_OWN, rows.own_row(node, data))
        row = data_rows.data_row(node.id, data, self._options)
        if row is not None:
            self._db.run(data_rows.INSERT_DATA, row)
        if data.features is not None:
            self._write_features(node.id, data.features)
        self._previous[node.session] = node
        if node.id % _BATCH == 0:
            self._db.commit()
        self._commit()

    def nodes(self) -> tuple[Node, ...]:
        if self._nodes is None:
            found = self._db.iterate(f"{rows.SELECT_OWN} ORDER BY own.id")
            self._nodes = tuple(map(rows.node_from_own_row, found))
        return self._nodes

    def node_data(self, node_id: int, *, features: bool = True) -> NodeData:
        own = self._db.row(
            "SELECT stamp_ns, scan_rest, image_stamps, cloud FROM mapmyworld_nodes WHERE id = ?",
            (node_id,),
        )
        if own is None:
            raise MapError(f"{self.path}: there is no node {node_id}")
        row = self._db.row(data_rows.SELECT_DATA, (node_id,))
        return data_rows.node_data(self._db, node_id, row, own[1:], own[0], features)

    def set_features(self, node_id: int, features: Features) -> None:
        self._begin()
        self._db.run("DELETE FROM Feature WHERE node_id = ?", (node_id,))
        self._write_features(node_id, features)
        self._commit()

    def _write_features(self, node_id: int, features: Features) -> None:
        self._db.run(_INSERT_STAGE, (node_id, self._current_rank()))
        written = feature_rows.feature_rows(node_id, features)
        self._db.run_many(feature_rows.INSERT_FEATURE, written)

    # Every tracked frame

    def add_scan(self, frame: int, scan: Scan) -> None:
        """The scan of the tracked frame with this index."""
        self._begin()
        insert = "INSERT OR REPLACE INTO mapmyworld_scans VALUES (?,?)"
        self._db.run(insert, (frame, scan_to_blob(scan)))
        self._commit()

    def scans(self, frames: Sequence[int] | NDArray[np.int64]) -> Iterator[tuple[int, Scan]]:
        wanted = json.dumps(np.unique(np.asarray(frames, np.int64)).tolist())
        query = (
            "SELECT frame, scan FROM mapmyworld_scans"
            " WHERE frame IN (SELECT value FROM json_each(?)) ORDER BY frame"
        )
        for frame, blob in self._db.iterate(query, (wanted,)):
            yield frame, blob_to_scan(blob, f"{self.path}: scan {frame}")

    def set_tracked_frames(self, frames: TrackedFrames) -> None:
        self._begin()
        self._write("tracked stamps_ns", frames.stamps_ns)
        self._write("tracked node_ids", frames.node_ids)
        self._write("tracked node_from_frame", frames.node_from_frame)
        self._write("tracked is_node", np.asarray(frames.is_node, np.uint8))
        self._write("tracked odom_from_base", frames.odom_from_base)
        self._commit()

    def tracked_frames(self) -> TrackedFrames:
        """As they were set, else one a node; raises `MapError` where they are damaged."""
        stamps = self._read("tracked stamps_ns", "i", (-1,))
        node_ids = self._read("tracked node_ids", "i", (-1,))
        motions = self._read("tracked node_from_frame", "f", (-1, 4, 4))
        is_node = self._read("tracked is_node", "u", (-1,))
        if stamps is None or node_ids is None or motions is None or is_node is None:
            return nodes_as_frames(self.nodes())
        odometry = self._read("tracked odom_from_base", "f", (-1, 4, 4))
        what = "tracked frames"
        self._check_lengths(what, stamps, node_ids, motions, is_node, odometry)
        unknown = np.setdiff1d(node_ids, [node.id for node in self.nodes()])
        if len(unknown):
            raise MapError(
                f"{self.path}: {what}: a damaged array (of node {unknown[0]}, which is none)"
            )
        return TrackedFrames(stamps, node_ids, motions, is_node.astype(np.bool_), odometry)

    def _restore_session(self) -> None:
        """Takes up where the file stands: the last node of each session, the log's clock."""
        last = "(SELECT MAX(id) FROM mapmyworld_nodes GROUP BY session)"
        found = self._db.rows(f"{rows.SELECT_OWN} WHERE own.id IN {last}")
        self._previous = {row[1]: rows.node_from_own_row(row) for row in found}
        first = self._db.row("SELECT id, stamp_ns FROM mapmyworld_nodes ORDER BY id LIMIT 1")
        if first is not None:
            if not isinstance(first[1], int):
                raise MapError(f"{self.path}: node {first[0]}: a damaged row (without a stamp)")
            self._db.set_clock(first[1])
