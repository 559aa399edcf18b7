"""Pose graphs from text: g2o, TORO and GTSAM's landmark format.

Read are (translation before rotation, upper triangles row by row):
g2o   VERTEX_SE2 EDGE_SE2 VERTEX_SE3:QUAT EDGE_SE3:QUAT VERTEX_XY EDGE_SE2_XY VERTEX_TRACKXYZ
      EDGE_SE3_TRACKXYZ EDGE_PRIOR_SE2 EDGE_SE3_PRIOR FIX PARAMS_SE3OFFSET; # begins a comment
TORO  VERTEX2 EDGE2 VERTEX3 EDGE3
GTSAM ODOMETRY LANDMARK (with covariances) BR (bearing, range and their standard deviations)
"""

from __future__ import annotations

import re
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from formats.graph_edges import edges_of, priors_of, sightings_of
from formats.graph_lines import Columns, Table, listed, tables_from_text
from formats.graph_numbers import POSES
from formats.whole_files import read_whole
from mapmyworld.errors import MapError
from mapmyworld.geometry import Array
from mapmyworld.types.pose_graph import Edges, PoseGraph

Index = NDArray[np.int64]

_COLUMNS = {
    "VERTEX_SE2": Columns(4, ids=1),
    "VERTEX2": Columns(4, ids=1),
    "VERTEX_SE3:QUAT": Columns(8, ids=1, quaternion=4),
    "VERTEX3": Columns(7, ids=1),
    "VERTEX_XY": Columns(3, ids=1),
    "VERTEX_TRACKXYZ": Columns(4, ids=1),
    "EDGE_SE2": Columns(11, ids=2),
    "EDGE2": Columns(11, ids=2),
    "ODOMETRY": Columns(11, ids=2),
    "EDGE_SE3:QUAT": Columns(30, ids=2, quaternion=5),
    "EDGE3": Columns(29, ids=2),
    "EDGE_SE2_XY": Columns(7, ids=2),
    "LANDMARK": Columns(7, ids=2),
    "BR": Columns(6, ids=2),
    "EDGE_SE3_TRACKXYZ": Columns(12, ids=3),
    "EDGE_PRIOR_SE2": Columns(10, ids=1),
    "EDGE_SE3_PRIOR": Columns(30, ids=2, quaternion=5),
    "PARAMS_SE3OFFSET": Columns(8, ids=1, quaternion=4),
    "PARAMS_SE2OFFSET": Columns(4, ids=1),  # of kinds of edges that are not read
}
_COMMENT = re.compile("#[^\r\n]*")
_PLANAR = {"VERTEX_SE2", "VERTEX2", "EDGE_SE2", "EDGE2", "ODOMETRY", "EDGE_PRIOR_SE2"}
_SPATIAL = {"VERTEX_SE3:QUAT", "VERTEX3", "EDGE_SE3:QUAT", "EDGE3", "EDGE_SE3_PRIOR"}


@dataclass(frozen=True, slots=True, eq=False)
class GraphFile:
    """What a graph file holds, and what of it could not be used."""

    graph: PoseGraph
    problems: tuple[str, ...]
    """Every fault found; what they concern is left out of the graph."""
    notes: tuple[str, ...]
    """Peculiarities that lose nothing."""


def read_graph(path: Path) -> GraphFile:
    """The graph in a g2o, TORO or GTSAM text file; raises `MapError` when there is none."""
    text = read_whole(path).decode("utf-8", errors="replace")
    try:
        return graph_from_text(text)
    except MapError as error:
        raise MapError(f"{path}: {error}") from error


def graph_from_text(text: str) -> GraphFile:
    """The graph in a text of one of these formats.

    Edges between a node and the next one by id are taken for odometry. Raises `MapError` where
    nothing of a known kind is in it, or planar and spatial poses both.
    """
    if "#" in text:
        text = _COMMENT.sub("", text)
    tables, others, problems = tables_from_text(text, _COLUMNS)
    planar, spatial = bool(_PLANAR & set(tables)), bool(_SPATIAL & set(tables))
    if planar and spatial:
        raise MapError("both planar (SE2) and spatial (SE3) poses: split the file in two")
    if not planar and not spatial:
        raise MapError("no poses and no edges of a known kind: is this a g2o or TORO file?")
    return _Reader(planar, tables, others, problems).read()


class _Reader:
    """Collects one graph from tables; `problems` and `notes` grow on the way."""

    def __init__(
        self,
        planar: bool,
        tables: dict[str, Table],
        others: dict[str, list[tuple[int, str]]],
        problems: list[str],
    ) -> None:
        self.planar = planar
        self.tables = tables
        self.others = others
        self.problems = problems
        self.notes: list[str] = []

    def read(self) -> GraphFile:
        fixed = self._fixed()
        for tag, lines in sorted(self.others.items()):
            where = listed([line for line, _ in lines])
            self.problems.append(f"{len(lines)} lines of unknown kind {tag[:24]!r} (line {where})")
        known = self.tables, self.planar, self.problems
        edges, sightings, priors = edges_of(*known), sightings_of(*known), priors_of(*known)
        named = np.concatenate([edges.from_ids, edges.to_ids, sightings.node_ids])
        ids, poses = self._nodes(named)
        landmark_ids, landmarks = self._landmarks(sightings.landmark_ids)
        placed = _among(priors.ids, ids)
        if not placed.all():
            self.problems.append(f"priors of unknown nodes {listed(priors.ids[~placed])}")
            priors = priors.chosen(placed)
        step = ids.searchsorted(edges.to_ids) - ids.searchsorted(edges.from_ids)
        measured = edges.from_ids, edges.to_ids, edges.i_from_j, edges.information
        graph = PoseGraph(
            self.planar,
            ids,
            poses,
            Edges(*measured, odometry=np.abs(step) == 1),
            landmark_ids,
            landmarks,
            sightings,
            priors,
            self._known_fixed(fixed, ids),
        )
        return GraphFile(graph, tuple(self.problems), tuple(self.notes))

    def _fixed(self) -> Index:
        found: list[int] = []
        lines = self.others.pop("FIX", [])
        if not lines:
            return np.zeros(0, np.int64)
        for line, rest in lines:
            try:
                found += np.array([int(token) for token in rest.split()], np.int64).tolist()
            except (ValueError, OverflowError):
                self.problems.append(f"line {line}: FIX takes whole numbers")
        return np.unique(np.array(found, np.int64))

    def _known_fixed(self, fixed: Index, ids: Index) -> Index:
        known = _among(fixed, ids)
        if not known.all():
            self.problems.append(f"FIX of unknown nodes {listed(fixed[~known])}")
        return fixed[known]

    def _nodes(self, named: Index) -> tuple[Index, Array]:
        """Ids and poses of the vertices, and of nodes that only edges name."""
        tags = ("VERTEX_SE2", "VERTEX2") if self.planar else ("VERTEX_SE3:QUAT", "VERTEX3")
        parts = [(tag, self.tables[tag]) for tag in tags if tag in self.tables]
        origin = np.zeros(3) if self.planar else np.eye(4)
        numbers = [np.zeros((0, *origin.shape))]
        ids, lines = [np.zeros(0, np.int64)], [np.zeros(0, np.int64)]
        for tag, table in parts:
            ids.append(table.numbers[:, 0].astype(np.int64))
            lines.append(table.lines)
            numbers.append(POSES[tag](table.numbers[:, 1:]))
        unique, poses = self._without_duplicates(
            np.concatenate(ids), np.concatenate(lines), np.concatenate(numbers)
        )
        placed = _among(named, unique)
        if placed.all():
            return unique, poses
        missing = np.unique(named[~placed])
        if len(unique):
            self.problems.append(
                f"{len(missing)} nodes have edges but no vertex ({listed(missing)}): "
                "placed by their edges"
            )
        else:
            self.notes.append(f"no vertices: {len(missing)} nodes are placed by their edges")
        every = np.concatenate([unique, missing])
        poses = np.concatenate([poses, np.broadcast_to(origin, (len(missing), *origin.shape))])
        order = np.argsort(every)
        return every[order], poses[order]

    def _without_duplicates(self, ids: Index, lines: Index, values: Array) -> tuple[Index, Array]:
        """Ids in ascending order, each once, and what belongs to them."""
        if (ids[1:] > ids[:-1]).all():
            return ids, values
        unique, first = np.unique(ids, return_index=True)
        if len(unique) < len(ids):
            again = np.setdiff1d(np.arange(len(ids)), first)
            self.problems.append(
                f"{len(again)} vertices with an id that was taken (line {listed(lines[again])}): "
                "the first one counts"
            )
        return unique, values[first]

    def _landmarks(self, seen: Index) -> tuple[Index, Array]:
        size = 2 if self.planar else 3
        table = self.tables.get("VERTEX_XY" if self.planar else "VERTEX_TRACKXYZ")
        ids, points = np.zeros(0, np.int64), np.zeros((0, size))
        if table is None and len(seen) == 0:
            return ids, points
        if table is not None:
            ids, points = self._without_duplicates(
                table.numbers[:, 0].astype(np.int64), table.lines, table.numbers[:, 1:]
            )
        missing = np.unique(seen[~_among(seen, ids)])
        if len(missing) and len(ids):
            self.problems.append(f"landmarks without a vertex ({listed(missing)})")
        every = np.concatenate([ids, missing])
        order = np.argsort(every)
        return every[order], np.concatenate([points, np.zeros((len(missing), size))])[order]


def _among(wanted: Index, known: Index) -> NDArray[np.bool_]:
    """Which of these ids are among the ascending `known`."""
    if len(known) == 0 or len(wanted) == 0:
        return np.zeros(len(wanted), np.bool_)
    return np.asarray(known[np.minimum(known.searchsorted(wanted), len(known) - 1)] == wanted)
