"""A database that RTAB-Map wrote, as a finished map: read, never changed."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Any, NoReturn

import numpy as np
from numpy.typing import NDArray

from formats.database import feature_rows
from formats.database import foreign_graph as graph
from formats.database.blobs import blob_to_matrix, blob_to_pose
from formats.database.connection import Connection, Opened
from formats.database.data_rows import SELECT_DATA, node_data
from formats.database.node_rows import blob_to_gps, nanoseconds
from mapmyworld.errors import MapError
from mapmyworld.types import (
    Judged,
    Node,
    NodeData,
    OccupancyGrid,
    Poses,
    Scan,
    TrackedFrames,
)
from mapmyworld.types.frames import nodes_as_frames

_OLDEST = (0, 18, 0)  # of the layout that is read: all columns are there since
_SELECT_NODES = (
    "SELECT id, map_id, weight, stamp, pose, ground_truth_pose, gps FROM Node ORDER BY id"
)
_INVALID_WEIGHT = -9  # merged into another node, or deleted
# Log-odds that stand for the three values of a stored grid: beyond its thresholds.
_LOG_ODDS = {100: 3.0, 0: -3.0}


class RtabmapStore(Opened):
    """The reading half of a MapStore, from RTAB-Map's own tables."""

    def __init__(self, connection: Connection) -> None:
        super().__init__(connection)
        self._problems: dict[str, None] = {}
        self._check_version()
        self._nodes: tuple[Node, ...] | None = None

    @property
    def problems(self) -> tuple[str, ...]:
        """What was left out so far, one line each."""
        return tuple(self._problems)

    def _check_version(self) -> None:
        if "id" not in self._db.columns("Node") or "version" not in self._db.columns("Admin"):
            raise MapError(f"{self.path}: is a database, but neither a map nor RTAB-Map's")
        found = self._db.rows("SELECT version FROM Admin")
        version = str(found[0][0]) if len(found) == 1 and found[0][0] else ""
        try:
            numbers = tuple(int(part) for part in version.split(".")[:3])
        except ValueError:
            numbers = ()
        if not numbers:
            raise MapError(f"{self.path}: does not say which version of RTAB-Map wrote it")
        if numbers < _OLDEST:
            raise MapError(
                f"{self.path}: was written by RTAB-Map {version}, whose format is too old:"
                ' convert it with `rtabmap-reprocess --Db/TargetVersion "" old.db new.db`'
            )

    def _refuse(self, *_given: Any, **_named: Any) -> NoReturn:
        """Instead of the writing half of a MapStore."""
        raise MapError(
            f"{self.path}: is a database of RTAB-Map's and is never changed: write the result to"
            " another file with -o, or build a map of it with `mapmyworld build`"
        )

    write_stage = extend_stage = put = add_node = add_scan = set_tracked_frames = _refuse
    add_constraints = judge = set_features = set_words = set_poses = set_frame_poses = _refuse
    set_grid = _refuse

    # What only our own builds keep

    def stage_done(self, stage: str, inputs: str | None) -> bool:
        return False

    def get(self, key: str) -> Any:
        return None

    def frame_poses(self) -> NDArray[np.float64] | None:
        return None

    # Nodes

    def nodes(self) -> tuple[Node, ...]:
        """Nodes by id; those that RTAB-Map merged away are left out."""
        if self._nodes is None:
            found = map(self._node, self._db.rows(_SELECT_NODES))
            self._nodes = tuple(node for node in found if node is not None)
        return self._nodes

    def _node(self, row: tuple[Any, ...]) -> Node | None:
        node_id, session, weight, stamp, pose_blob, truth_blob, gps_blob = row
        if weight == _INVALID_WEIGHT or node_id <= 0:
            return None
        try:
            pose = blob_to_pose(pose_blob, f"node {node_id}'s pose")
            truth = blob_to_pose(truth_blob, f"node {node_id}'s ground truth")
            moment = nanoseconds(stamp)
            gps = blob_to_gps(gps_blob, f"node {node_id}'s gps")
        except (MapError, ArithmeticError, TypeError, ValueError) as error:
            self._leave_out(f"{error}: the node is left out")
            return None
        if pose is None:
            self._leave_out(f"node {node_id} has no odometry pose: it is left out")
            return None
        return Node(node_id, session or 0, moment, pose, pose, weight or 0, truth, gps)

    def _leave_out(self, problem: str) -> None:
        self._problems[problem] = None

    def node_data(self, node_id: int, *, features: bool = True) -> NodeData:
        stamp = self._db.row("SELECT stamp FROM Node WHERE id = ?", (node_id,))
        if stamp is None:
            raise MapError(f"{self.path}: there is no node {node_id}")
        row = self._db.row(SELECT_DATA, (node_id,))
        return node_data(self._db, node_id, row, None, nanoseconds(stamp[0]), features)

    def words(self) -> dict[int, NDArray[Any]]:
        return feature_rows.read_words(self._db)

    # Frames: only nodes were kept

    def tracked_frames(self) -> TrackedFrames:
        """One frame a node, numbered from 0 in their order."""
        return nodes_as_frames(self.nodes())

    def scans(self, frames: Sequence[int] | NDArray[np.int64]) -> Iterator[tuple[int, Scan]]:
        """Scans of the nodes with these indices (K,) in `nodes()`."""
        nodes = self.nodes()
        for frame in np.unique(np.asarray(frames, np.int64)).tolist():
            if 0 <= frame < len(nodes):
                scan = self.node_data(nodes[frame].id).scan
                if scan is not None:
                    yield frame, scan

    # The graph

    def constraints(self) -> tuple[Judged, ...]:
        """Links, one a pair and kind; dangling, null and damaged ones are left out."""
        known = {node.id for node in self.nodes()}
        found, problems = graph.constraints_from_links(self._db.rows(graph.SELECT_LINKS), known)
        for problem in problems:
            self._leave_out(problem)
        return found

    def poses(self) -> Poses | None:
        """The optimised poses; None where RTAB-Map did not come to write them."""
        ids, poses = self._db.row("SELECT opt_ids, opt_poses FROM Admin")
        return graph.poses_from_blobs(ids, poses, str(self.path))

    def grid(self) -> OccupancyGrid | None:
        """The stored grid; its three values become log-odds beyond the thresholds.

        Raises `MapError` where it is damaged.
        """
        row = self._db.row(
            "SELECT opt_map, opt_map_x_min, opt_map_y_min, opt_map_resolution FROM Admin"
        )
        matrix = blob_to_matrix(row[0], f"{self.path}: opt_map")
        if matrix is None:
            return None
        if matrix.dtype != np.int8 or None in row[1:] or not row[3] > 0:
            raise MapError(f"{self.path}: opt_map is not a grid of RTAB-Map's")
        cells = matrix[:, :, 0]
        log_odds = np.full(cells.shape, np.nan, np.float32)
        for value, figure in _LOG_ODDS.items():
            log_odds[cells == value] = figure
        return OccupancyGrid(log_odds, float(row[3]), np.array(row[1:3], np.float64))
