"""Pose graphs from text: g2o, TORO and GTSAM's landmark format.

Read are (translation before rotation, upper triangles row by row):
g2o   VERTEX_SE2 EDGE_SE2 VERTEX_SE3:QUAT EDGE_SE3:QUAT VERTEX_XY EDGE_SE2_XY VERTEX_TRACKXYZ
      EDGE_SE3_TRACKXYZ EDGE_PRIOR_SE2 EDGE_SE3_PRIOR FIX PARAMS_SE3OFFSET
TORO  VERTEX2 EDGE2 VERTEX3 EDGE3
GTSAM ODOMETRY LANDMARK (with covariances) BR (bearing, range and their standard deviations)
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from formats.graph_lines import Columns, Table, tables_from_text
from mapmyworld.errors import MapError
from mapmyworld.geometry import (
    SWAP_ROTATION_TRANSLATION,
    Array,
    invert,
    make_transform,
    quaternion_to_rotation,
    so3_exp,
)
from mapmyworld.types.pose_graph import Edges, PoseGraph, Priors, Sightings

Index = NDArray[np.int64]

_COLUMNS = {
    "VERTEX_SE2": Columns(4, ids=1),
    "VERTEX2": Columns(4, ids=1),
    "VERTEX_SE3:QUAT": Columns(8, ids=1),
    "VERTEX3": Columns(7, ids=1),
    "VERTEX_XY": Columns(3, ids=1),
    "VERTEX_TRACKXYZ": Columns(4, ids=1),
    "EDGE_SE2": Columns(11, ids=2),
    "EDGE2": Columns(11, ids=2),
    "ODOMETRY": Columns(11, ids=2),
    "EDGE_SE3:QUAT": Columns(30, ids=2),
    "EDGE3": Columns(29, ids=2),
    "EDGE_SE2_XY": Columns(7, ids=2),
    "LANDMARK": Columns(7, ids=2),
    "BR": Columns(6, ids=2),
    "EDGE_SE3_TRACKXYZ": Columns(12, ids=3),
    "EDGE_PRIOR_SE2": Columns(10, ids=1),
    "EDGE_SE3_PRIOR": Columns(30, ids=2),
    "PARAMS_SE3OFFSET": Columns(8, ids=1),
}
_PLANAR = {"VERTEX_SE2", "VERTEX2", "EDGE_SE2", "EDGE2", "ODOMETRY", "EDGE_PRIOR_SE2"}
_SPATIAL = {"VERTEX_SE3:QUAT", "VERTEX3", "EDGE_SE3:QUAT", "EDGE3", "EDGE_SE3_PRIOR"}
_LEAST_VARIANCE = 1e-30  # m^2 or rad^2
_SHOWN = 5  # line numbers or ids in one message


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
    try:
        text = path.read_text(encoding="utf-8", errors="replace")
    except OSError as error:
        raise MapError(f"{path}: {error.strerror or error}") from error
    try:
        return graph_from_text(text)
    except MapError as error:
        raise MapError(f"{path}: {error}") from error


def graph_from_text(text: str) -> GraphFile:
    """The graph in a text of one of these formats.

    Edges between a node and the next one by id are taken for odometry.
    """
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
            where = _listed([line for line, _ in lines])
            self.problems.append(f"{len(lines)} lines of unknown kind {tag!r} (line {where})")
        edges, sightings, priors = self._edges(), self._sightings(), self._priors()
        named = np.unique(np.concatenate([edges.from_ids, edges.to_ids, sightings.node_ids]))
        ids, poses = self._nodes(named)
        landmark_ids, landmarks = self._landmarks(sightings.landmark_ids)
        known = np.isin(priors.ids, ids)
        if not known.all():
            self.problems.append(f"priors of unknown nodes {_listed(priors.ids[~known])}")
        step = np.searchsorted(ids, edges.to_ids) - np.searchsorted(ids, edges.from_ids)
        graph = PoseGraph(
            self.planar,
            ids,
            poses,
            replace(edges, odometry=np.abs(step) == 1),
            landmark_ids,
            landmarks,
            sightings,
            priors.chosen(known),
            self._known_fixed(fixed, ids),
        )
        return GraphFile(graph, tuple(self.problems), tuple(self.notes))

    def _fixed(self) -> Index:
        found: list[int] = []
        for line, rest in self.others.pop("FIX", []):
            try:
                found += [int(token) for token in rest.split()]
            except ValueError:
                self.problems.append(f"line {line}: FIX takes whole numbers")
        return np.unique(np.array(found, np.int64))

    def _known_fixed(self, fixed: Index, ids: Index) -> Index:
        known = np.isin(fixed, ids)
        if not known.all():
            self.problems.append(f"FIX of unknown nodes {_listed(fixed[~known])}")
        return fixed[known]

    def _nodes(self, named: Index) -> tuple[Index, Array]:
        """Ids and poses of the vertices, and of nodes that only edges name."""
        tags = ("VERTEX_SE2", "VERTEX2") if self.planar else ("VERTEX_SE3:QUAT", "VERTEX3")
        parts = [(tag, self.tables[tag]) for tag in tags if tag in self.tables]
        size = (3,) if self.planar else (4, 4)
        numbers = [np.zeros((0, *size))]
        ids, lines = [np.zeros(0, np.int64)], [np.zeros(0, np.int64)]
        for tag, table in parts:
            ids.append(table.numbers[:, 0].astype(np.int64))
            lines.append(table.lines)
            numbers.append(_POSES[tag](table.numbers[:, 1:]))
        unique, poses = self._without_duplicates(
            np.concatenate(ids), np.concatenate(lines), np.concatenate(numbers)
        )
        missing = np.setdiff1d(named, unique)
        if len(missing) and len(unique):
            self.problems.append(
                f"{len(missing)} nodes have edges but no vertex ({_listed(missing)}): "
                "placed by their edges"
            )
        elif len(missing):
            self.notes.append(f"no vertices: {len(missing)} nodes are placed by their edges")
        origin = np.zeros(3) if self.planar else np.eye(4)
        every = np.concatenate([unique, missing])
        poses = np.concatenate([poses, np.broadcast_to(origin, (len(missing), *size))])
        order = np.argsort(every)
        return every[order], poses[order]

    def _without_duplicates(self, ids: Index, lines: Index, values: Array) -> tuple[Index, Array]:
        unique, first = np.unique(ids, return_index=True)
        if len(unique) < len(ids):
            again = np.setdiff1d(np.arange(len(ids)), first)
            self.problems.append(
                f"{len(again)} vertices with an id that was taken (line {_listed(lines[again])}): "
                "the first one counts"
            )
        return unique, values[first]

    def _edges(self) -> Edges:
        tags = ("EDGE_SE2", "EDGE2", "ODOMETRY") if self.planar else ("EDGE_SE3:QUAT", "EDGE3")
        width = 3 if self.planar else 6
        found = [_no_edges(self.planar)]
        for tag in tags:
            if tag not in self.tables:
                continue
            table = self.tables[tag]
            ends = table.numbers[:, :2].astype(np.int64)
            entries = len(_TRIANGLE[width][0])
            information = _symmetric(table.numbers[:, -entries:], _ORDER.get(tag, slice(None)))
            if tag == "ODOMETRY":
                information = _inverted(information)
            if not self.planar:
                information = _rotation_first(information)
            poses = _POSES[tag](table.numbers[:, 2:-entries])
            good = self._sound(tag, table.lines, information)
            loop = ends[:, 0] == ends[:, 1]
            if loop.any():
                where = _listed(table.lines[loop])
                self.problems.append(f"{tag} from a node to itself (line {where})")
            good &= ~loop
            nothing = np.zeros(len(ends), np.bool_)
            found.append(Edges(ends[:, 0], ends[:, 1], poses, information, nothing).chosen(good))
        return _joined(found)

    def _sound(self, tag: str, lines: Index, information: Array) -> NDArray[np.bool_]:
        lowest = np.linalg.eigvalsh(information)[:, 0]
        scale = np.abs(information).max(axis=(1, 2), initial=0.0)
        good = lowest > 1e-14 * scale
        if not good.all():
            self.problems.append(
                f"{np.count_nonzero(~good)} {tag} whose information is not positive definite "
                f"(line {_listed(lines[~good])})"
            )
        return np.asarray(good)

    def _sightings(self) -> Sightings:
        size = 2 if self.planar else 3
        parts: list[Sightings] = []
        tags = ("EDGE_SE2_XY", "LANDMARK", "BR") if self.planar else ("EDGE_SE3_TRACKXYZ",)
        for tag in map(str, tags):
            if tag not in self.tables:
                continue
            table = self.tables[tag]
            values = table.numbers
            ids = values[:, :2].astype(np.int64)
            if tag == "BR":
                measured = values[:, 2:4]
                information = np.zeros((len(values), 2, 2))
                variances = values[:, 4:6] ** 2
                told = variances > _LEAST_VARIANCE
                information[:, [0, 1], [0, 1]] = np.where(
                    told, 1.0 / np.where(told, variances, 1), 0
                )
            else:
                skip = 2 if self.planar else 3
                measured = values[:, skip : skip + size]
                information = _symmetric(values[:, skip + size :], slice(None))
            if tag == "LANDMARK":
                information = _inverted(information)
            if tag == "EDGE_SE3_TRACKXYZ":
                measured, information = self._at_node(values[:, 2], measured, information)
            polar = np.full(len(values), tag == "BR")
            good = self._sound(tag, table.lines, information)
            parts.append(Sightings(ids[:, 0], ids[:, 1], measured, information, polar).chosen(good))
        return _joined_sightings(parts, size)

    def _at_node(
        self, offset_ids: Array, measured: Array, information: Array
    ) -> tuple[Array, Array]:
        """Points and information in the node's frame instead of the offset sensor's."""
        table = self.tables.get("PARAMS_SE3OFFSET")
        if table is None:
            return measured, information
        offsets = {int(row[0]): _from_quaternions(row[1:]) for row in table.numbers}
        motion = np.array([offsets.get(int(k), np.eye(4)) for k in offset_ids]).reshape(-1, 4, 4)
        turn = motion[:, :3, :3]
        points = np.einsum("kij,kj->ki", turn, measured) + motion[:, :3, 3]
        return points, turn @ information @ np.swapaxes(turn, 1, 2)

    def _priors(self) -> Priors:
        tag = "EDGE_PRIOR_SE2" if self.planar else "EDGE_SE3_PRIOR"
        width = 3 if self.planar else 6
        if tag not in self.tables:
            shape = (0, 3) if self.planar else (0, 4, 4)
            return Priors(np.zeros(0, np.int64), np.zeros(shape), np.zeros((0, width, width)))
        table = self.tables[tag]
        entries = len(_TRIANGLE[width][0])
        information = _symmetric(table.numbers[:, -entries:], slice(None))
        if self.planar:
            poses = table.numbers[:, 1:4]
        else:
            information = _rotation_first(information)
            poses = self._without_offset(table)
        good = self._sound(tag, table.lines, information)
        return Priors(table.numbers[:, 0].astype(np.int64), poses, information).chosen(good)

    def _without_offset(self, table: Table) -> Array:
        poses = _from_quaternions(table.numbers[:, 2:9])
        offsets = self.tables.get("PARAMS_SE3OFFSET")
        known = {} if offsets is None else {int(r[0]): r[1:] for r in offsets.numbers}
        for k, offset in enumerate(table.numbers[:, 1].astype(int).tolist()):
            if offset in known:
                poses[k] = poses[k] @ invert(_from_quaternions(known[offset]))
        return poses

    def _landmarks(self, seen: Index) -> tuple[Index, Array]:
        size = 2 if self.planar else 3
        table = self.tables.get("VERTEX_XY" if self.planar else "VERTEX_TRACKXYZ")
        ids, points = np.zeros(0, np.int64), np.zeros((0, size))
        if table is not None:
            ids, points = self._without_duplicates(
                table.numbers[:, 0].astype(np.int64), table.lines, table.numbers[:, 1:]
            )
        missing = np.setdiff1d(seen, ids)
        if len(missing) and len(ids):
            self.problems.append(f"landmarks without a vertex ({_listed(missing)})")
        every = np.concatenate([ids, missing])
        order = np.argsort(every)
        return every[order], np.concatenate([points, np.zeros((len(missing), size))])[order]


_TRIANGLE = {size: np.triu_indices(size) for size in (2, 3, 6)}
# TORO's order of the six entries of a planar information: ff, fs, ss, rr, fr, sr.
_ORDER: dict[str, list[int] | slice] = {"EDGE2": [0, 1, 4, 2, 5, 3]}


def _symmetric(entries: Array, order: list[int] | slice) -> Array:
    """Matrices (R, d, d) of upper triangles (R, d (d + 1) / 2)."""
    values = entries[:, order]
    size = {3: 2, 6: 3, 21: 6}[values.shape[1]]
    rows, columns = _TRIANGLE[size]
    matrices = np.zeros((len(values), size, size))
    matrices[:, rows, columns] = values
    matrices[:, columns, rows] = values
    return matrices


def _inverted(covariances: Array) -> Array:
    """Information matrices; zeros, which no edge may have, of what is no covariance."""
    lowest = np.linalg.eigvalsh(covariances)[:, 0]
    good = lowest > 1e-14 * np.abs(covariances).max(axis=(1, 2), initial=_LEAST_VARIANCE)
    found = np.zeros(covariances.shape)
    found[good] = np.linalg.inv(covariances[good])
    return found


def _rotation_first(information: Array) -> Array:
    return information[:, SWAP_ROTATION_TRANSLATION[:, None], SWAP_ROTATION_TRANSLATION]


def _planar(numbers: Array) -> Array:
    return numbers[..., :3].copy()


def _from_quaternions(numbers: Array) -> Array:
    return make_transform(quaternion_to_rotation(numbers[..., 3:7]), numbers[..., :3])


def _from_angles(numbers: Array) -> Array:
    """Poses of x, y, z, roll, pitch, yaw (R, 6)."""
    roll, pitch, yaw = (so3_exp(numbers[:, 3 + k, None] * np.eye(3)[k]) for k in range(3))
    return make_transform(yaw @ pitch @ roll, numbers[:, :3])


_POSES: dict[str, Callable[[Array], Array]] = {
    "VERTEX_SE2": _planar,
    "VERTEX2": _planar,
    "EDGE_SE2": _planar,
    "EDGE2": _planar,
    "ODOMETRY": _planar,
    "VERTEX_SE3:QUAT": _from_quaternions,
    "EDGE_SE3:QUAT": _from_quaternions,
    "VERTEX3": _from_angles,
    "EDGE3": _from_angles,
}


def _no_edges(planar: bool) -> Edges:
    ids = np.zeros(0, np.int64)
    if planar:
        return Edges(ids, ids, np.zeros((0, 3)), np.zeros((0, 3, 3)), np.zeros(0, np.bool_))
    return Edges(ids, ids, np.zeros((0, 4, 4)), np.zeros((0, 6, 6)), np.zeros(0, np.bool_))


def _joined(parts: list[Edges]) -> Edges:
    return Edges(
        np.concatenate([p.from_ids for p in parts]),
        np.concatenate([p.to_ids for p in parts]),
        np.concatenate([p.from_from_to for p in parts]),
        np.concatenate([p.information for p in parts]),
        np.concatenate([p.odometry for p in parts]),
    )


def _joined_sightings(parts: list[Sightings], size: int) -> Sightings:
    ids = [np.zeros(0, np.int64)]
    return Sightings(
        np.concatenate(ids + [p.node_ids for p in parts]),
        np.concatenate(ids + [p.landmark_ids for p in parts]),
        np.concatenate([np.zeros((0, size)), *(p.measured for p in parts)]),
        np.concatenate([np.zeros((0, size, size)), *(p.information for p in parts)]),
        np.concatenate([np.zeros(0, np.bool_), *(p.polar for p in parts)]),
    )


def _listed(values: Index | list[int]) -> str:
    shown = ", ".join(str(int(v)) for v in values[:_SHOWN])
    return f"{shown} and {len(values) - _SHOWN} more" if len(values) > _SHOWN else shown
