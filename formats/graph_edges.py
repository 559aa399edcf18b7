"""Edges, sightings and priors from the tables of a graph file.

And its numbers as poses and matrices: triangles, quaternions, angles, covariances.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from formats.graph_lines import Table, listed
from mapmyworld.geometry import Array, Index
from mapmyworld.geometry.rigid import SWAP_ROTATION_TRANSLATION, invert, make_transform
from mapmyworld.geometry.rotations import quaternion_to_rotation, so3_exp
from mapmyworld.types.pose_graph import Edges, Priors, Sightings, no_priors, no_sightings

Tables = dict[str, Table]

_LEAST_VARIANCE = 1e-30  # m^2 or rad^2


def _layout(size: int) -> Index:
    layout = np.zeros((size, size), np.int64)
    rows, columns = np.triu_indices(size)
    layout[rows, columns] = layout[columns, rows] = np.arange(len(rows))
    return layout


_ROW_BY_ROW = {size: _layout(size) for size in (2, 3, 6)}
"""Size d -> where in an upper triangle each entry (d, d) of its matrix stands."""
# TORO's order of the six entries of a planar information: ff, fs, ss, rr, fr, sr.
_TORO = np.array([0, 1, 4, 2, 5, 3])[_ROW_BY_ROW[3]]
# For a matrix (6, 6) with rotation first, of files that put the translation first.
_ROTATION_FIRST = _ROW_BY_ROW[6][SWAP_ROTATION_TRANSLATION[:, None], SWAP_ROTATION_TRANSLATION]


def _symmetric(numbers: Array, layout: Index) -> Array:
    """Matrices (R, d, d) by `layout` (d, d) of the upper triangles at the ends of rows (R, ...)."""
    size = len(layout)
    return numbers[:, -(size * (size + 1) // 2) :].take(layout, axis=1)


def _inverted(covariances: Array) -> Array:
    """Information matrices of covariances, (N, d, d) both.

    Zeros, which no edge may have, of what is no covariance.
    """
    lowest = np.linalg.eigvalsh(covariances)[:, 0]
    good = lowest > 1e-14 * np.abs(covariances).max(axis=(1, 2), initial=_LEAST_VARIANCE)
    found = np.zeros(covariances.shape)
    found[good] = np.linalg.inv(covariances[good])
    return found


def _from_quaternions(numbers: Array) -> Array:
    """Poses (..., 4, 4) of x, y, z and a quaternion x y z w (..., 7)."""
    return make_transform(quaternion_to_rotation(numbers[..., 3:7]), numbers[..., :3])


def _from_angles(numbers: Array) -> Array:
    """Poses of x, y, z, roll, pitch, yaw (R, 6)."""
    roll, pitch, yaw = (so3_exp(numbers[:, 3 + k, None] * np.eye(3)[k]) for k in range(3))
    return make_transform(yaw @ pitch @ roll, numbers[:, :3])


def poses_of(tag: str, numbers: Array) -> Array:
    """Poses (R, 3) or (R, 4, 4), or points (R, 2) or (R, 3), of the numbers (R, C) behind a tag."""
    if tag.endswith(":QUAT"):
        return _from_quaternions(numbers)
    return _from_angles(numbers) if tag in ("VERTEX3", "EDGE3") else numbers[:, :3].copy()


def edges_of(tables: Tables, planar: bool, problems: list[str]) -> Edges:
    """Constraints between poses; faults are reported in `problems`."""
    tags = ("EDGE_SE2", "EDGE2", "ODOMETRY") if planar else ("EDGE_SE3:QUAT", "EDGE3")
    found = [_edges_of(tag, tables[tag], planar, problems) for tag in tags if tag in tables]
    ids, none = np.zeros(0, np.int64), no_priors(planar)
    empty = Edges(ids, ids, none.map_from_node, none.information, np.zeros(0, np.bool_))
    return empty.followed_by(*found)


def _edges_of(tag: str, table: Table, planar: bool, problems: list[str]) -> Edges:
    tails, heads = np.ascontiguousarray(table.numbers[:, :2].astype(np.int64).T)
    layout = _TORO if tag == "EDGE2" else _ROW_BY_ROW[3] if planar else _ROTATION_FIRST
    information = _symmetric(table.numbers, layout)
    if tag == "ODOMETRY":
        information = _inverted(information)
    poses = poses_of(tag, table.numbers[:, 2:])
    good, loop = _sound(problems, tag, table.lines, information), tails == heads
    if loop.any():
        problems.append(f"{tag} from a node to itself (line {listed(table.lines[loop])})")
    edges = Edges(tails, heads, poses, information, np.zeros(len(tails), np.bool_))
    good &= ~loop
    return edges.chosen(good)


def _sound(problems: list[str], tag: str, lines: Index, information: Array) -> NDArray[np.bool_]:
    """Which matrices (R, d, d) are positive definite; the others are reported."""
    least = 1e-14 * np.abs(information).sum(axis=2).max(axis=1, initial=0.0)
    good = np.linalg.eigvalsh(information)[:, 0] > least
    if not good.all():
        problems.append(
            f"{np.count_nonzero(~good)} {tag} whose information is not positive definite "
            f"(line {listed(lines[~good])})"
        )
    return np.asarray(good)


def sightings_of(tables: Tables, planar: bool, problems: list[str]) -> Sightings:
    """Landmarks as nodes see them; faults are reported in `problems`."""
    size = 2 if planar else 3
    parts = list[Sightings]()
    tags = ("EDGE_SE2_XY", "LANDMARK", "BR") if planar else ("EDGE_SE3_TRACKXYZ",)
    for tag in map(str, tags):
        if tag not in tables:
            continue
        table = tables[tag]
        values = table.numbers
        ids = values[:, :2].astype(np.int64)
        if tag == "BR":
            measured = values[:, 2:4]
            information = np.zeros((len(values), 2, 2))
            variances = values[:, 4:6] ** 2
            reported = variances > _LEAST_VARIANCE
            information[:, [0, 1], [0, 1]] = np.where(
                reported, 1.0 / np.where(reported, variances, 1), 0
            )
        else:
            skip = 2 if planar else 3
            measured = values[:, skip : skip + size]
            information = _symmetric(values, _ROW_BY_ROW[size])
        if tag == "LANDMARK":
            information = _inverted(information)
        if tag == "EDGE_SE3_TRACKXYZ":
            offsets = _offsets(tables, values[:, 2])
            measured, information = _at_node(offsets, measured, information)
        polar = np.full(len(values), tag == "BR")
        good = _sound(problems, tag, table.lines, information)
        parts.append(Sightings(ids[:, 0], ids[:, 1], measured, information, polar).chosen(good))
    return no_sightings(planar).followed_by(*parts)


def _at_node(motion: Array, measured: Array, information: Array) -> tuple[Array, Array]:
    """Points and information in the node's frame instead of the sensor's at `motion`."""
    turn = motion[:, :3, :3]
    points = np.einsum("kij,kj->ki", turn, measured) + motion[:, :3, 3]
    return points, turn @ information @ np.swapaxes(turn, 1, 2)


def _offsets(tables: Tables, numbers: Array) -> Array:
    """Where the sensors of these numbers (R,) sit, (R, 4, 4): at the node where none is stated."""
    table = tables.get("PARAMS_SE3OFFSET")
    known = {} if table is None else {int(r[0]): _from_quaternions(r[1:]) for r in table.numbers}
    return np.array([known.get(int(k), np.eye(4)) for k in numbers]).reshape(-1, 4, 4)


def priors_of(tables: Tables, planar: bool, problems: list[str]) -> Priors:
    """Poses that are known of themselves; faults are reported in `problems`."""
    tag = "EDGE_PRIOR_SE2" if planar else "EDGE_SE3_PRIOR"
    if tag not in tables:
        return no_priors(planar)
    table = tables[tag]
    information = _symmetric(table.numbers, _ROW_BY_ROW[3] if planar else _ROTATION_FIRST)
    poses = table.numbers[:, 1:4]
    if not planar:
        offsets = _offsets(tables, table.numbers[:, 1])
        poses = _from_quaternions(table.numbers[:, 2:9]) @ invert(offsets)
    good = _sound(problems, tag, table.lines, information)
    return Priors(table.numbers[:, 0].astype(np.int64), poses, information).chosen(good)
