"""Pose graphs from text: g2o, TORO and GTSAM's landmark format.

Read are (translation before rotation, upper triangles row by row):
g2o   VERTEX_SE2 EDGE_SE2 VERTEX_SE3:QUAT EDGE_SE3:QUAT VERTEX_XY EDGE_SE2_XY VERTEX_TRACKXYZ
      EDGE_SE3_TRACKXYZ EDGE_PRIOR_SE2 EDGE_SE3_PRIOR FIX PARAMS_SE3OFFSET; # begins a comment
TORO  VERTEX2 EDGE2 VERTEX3 EDGE3
GTSAM ODOMETRY LANDMARK (with covariances) BR (bearing, range and their standard deviations)
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from formats.graph_edges import edges_of, poses_of, priors_of, sightings_of
from formats.graph_lines import Columns, Table, listed, tables_from_text
from formats.whole_files import read_whole
from mapmyworld.errors import MapError
from mapmyworld.geometry import Array, Index
from mapmyworld.types.pose_graph import Edges, PoseGraph

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
# Of planar graphs and of spatial ones: tags of vertices, and what lies at the origin.
_NODES: dict[bool, tuple[tuple[str, ...], Array]] = {
    True: (("VERTEX_SE2", "VERTEX2"), np.zeros(3)),
    False: (("VERTEX_SE3:QUAT", "VERTEX3"), np.eye(4)),
}
_LANDMARKS: dict[bool, tuple[tuple[str, ...], Array]] = {
    True: (("VERTEX_XY",), np.zeros(2)),
    False: (("VERTEX_TRACKXYZ",), np.zeros(3)),
}


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
    fixed = _fixed(others.pop("FIX", []), problems)
    for tag, lines in sorted(others.items()):
        where = listed([line for line, _ in lines])
        problems.append(f"{len(lines)} lines of unknown kind {tag[:24]!r} (line {where})")
    known = tables, planar, problems
    edges, sightings, priors = edges_of(*known), sightings_of(*known), priors_of(*known)
    named = np.concatenate([edges.from_ids, edges.to_ids, sightings.node_ids])
    tags, origin = _NODES[planar]
    ids, poses, missing = _vertices(tables, tags, origin, named, problems)
    notes = list[str]()
    if 0 < len(missing) < len(ids):
        problems.append(
            f"{len(missing)} nodes have edges but no vertex ({listed(missing)}): "
            "placed by their edges"
        )
    elif len(missing):
        notes.append(f"no vertices: {len(missing)} nodes are placed by their edges")
    tags, origin = _LANDMARKS[planar]
    landmark_ids, landmarks, missing = _vertices(
        tables, tags, origin, sightings.landmark_ids, problems
    )
    if 0 < len(missing) < len(landmark_ids):
        problems.append(f"landmarks without a vertex ({listed(missing)})")
    if not (placed := np.isin(priors.ids, ids)).all():
        problems.append(f"priors of unknown nodes {listed(priors.ids[~placed])}")
        priors = priors.chosen(placed)
    if not (placed := np.isin(fixed, ids)).all():
        problems.append(f"FIX of unknown nodes {listed(fixed[~placed])}")
        fixed = fixed[placed]
    step = ids.searchsorted(edges.to_ids) - ids.searchsorted(edges.from_ids)
    measured = edges.from_ids, edges.to_ids, edges.i_from_j, edges.information
    edges = Edges(*measured, odometry=np.abs(step) == 1)
    graph = PoseGraph(planar, ids, poses, edges, landmark_ids, landmarks, sightings, priors, fixed)
    return GraphFile(graph, tuple(problems), tuple(notes))


def _fixed(lines: list[tuple[int, str]], problems: list[str]) -> Index:
    found: list[int] = []
    for line, rest in lines:
        try:
            found += np.array([int(token) for token in rest.split()], np.int64).tolist()
        except (ValueError, OverflowError):
            problems.append(f"line {line}: FIX takes whole numbers")
    return np.unique(np.array(found, np.int64))


def _vertices(
    tables: dict[str, Table],
    tags: Sequence[str],
    origin: Array,
    named: Index,
    problems: list[str],
) -> tuple[Index, Array, Index]:
    """Ids and places of the vertices and of what only edges name, and the ids of the latter.

    The ids ascend; what only edges name lies at the origin.
    """
    ids, lines = [np.zeros(0, np.int64)], [np.zeros(0, np.int64)]
    places = [np.zeros((0, *origin.shape))]
    for tag in tags:
        if tag in tables:
            ids.append(tables[tag].numbers[:, 0].astype(np.int64))
            lines.append(tables[tag].lines)
            places.append(poses_of(tag, tables[tag].numbers[:, 1:]))
    every = np.concatenate(ids)
    unique, first = np.unique(every, return_index=True)
    if len(unique) < len(every):
        again = np.setdiff1d(np.arange(len(every)), first)
        problems.append(
            f"{len(again)} vertices with an id that was taken "
            f"(line {listed(np.concatenate(lines)[again])}): the first one counts"
        )
    missing = np.setdiff1d(named, unique)
    unplaced = np.broadcast_to(origin, (len(missing), *origin.shape))
    order = np.argsort(np.concatenate([unique, missing]))
    return (
        np.concatenate([unique, missing])[order],
        np.concatenate([np.concatenate(places)[first], unplaced])[order],
        missing,
    )
