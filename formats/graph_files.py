"""Pose graphs as g2o files; `graph_reading.py` reads them, and other kinds."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from formats.whole_files import write_whole
from mapmyworld.geometry import Array
from mapmyworld.geometry.rigid import SWAP_ROTATION_TRANSLATION
from mapmyworld.geometry.rotations import rotation_to_quaternion
from mapmyworld.types.pose_graph import PoseGraph, Sightings

# Of vertices, landmarks, edges, sightings and priors, in the plane and in space.
_TAGS = {
    True: ("VERTEX_SE2", "VERTEX_XY", "EDGE_SE2", "EDGE_SE2_XY", "EDGE_PRIOR_SE2"),
    False: (
        "VERTEX_SE3:QUAT",
        "VERTEX_TRACKXYZ",
        "EDGE_SE3:QUAT",
        "EDGE_SE3_TRACKXYZ",
        "EDGE_SE3_PRIOR",
    ),
}


def write_graph(path: Path, graph: PoseGraph) -> None:
    """A g2o file; every number survives the round trip to the last bit but for quaternions."""
    write_whole(path, text_from_graph(graph))


def text_from_graph(graph: PoseGraph) -> str:
    """The graph as g2o text: vertices, landmarks, fixed nodes, edges, priors."""
    return "".join(f"{line}\n" for line in _lines_of(graph))


def _lines_of(graph: PoseGraph) -> Iterator[str]:
    vertex, landmark, edge, sighting, prior = _TAGS[graph.planar]
    poses, matrices = (np.asarray, _triangles) if graph.planar else (_with_quaternions, _spatial)
    sightings = cartesian(graph.sightings) if graph.planar else graph.sightings
    edges, priors, shift = graph.edges, graph.priors, 0
    marks = graph.landmark_ids
    if len(np.intersect1d(graph.ids, marks)) or (marks < 0).any():  # g2o has one series of ids
        shift = int(graph.ids.max(initial=0)) + 1 - int(marks.min(initial=0))
    if not graph.planar and (len(sightings) or len(priors)):
        yield "PARAMS_SE3OFFSET 0 0 0 0 0 0 0 1"
    yield from _lines(vertex, [graph.ids], poses(graph.map_from_node))
    yield from _lines(landmark, [graph.landmark_ids + shift], graph.landmarks)
    yield from (f"FIX {k}" for k in graph.fixed_ids.tolist())
    numbers = np.hstack([poses(edges.i_from_j), matrices(edges.information)])
    yield from _lines(edge, [edges.from_ids, edges.to_ids], numbers)
    numbers = np.hstack([sightings.measured, _triangles(sightings.information)])
    ends = [sightings.node_ids, sightings.landmark_ids + shift]
    yield from _lines(sighting, ends + _offsets(graph, len(sightings)), numbers)
    numbers = np.hstack([poses(priors.map_from_node), matrices(priors.information)])
    yield from _lines(prior, [priors.ids, *_offsets(graph, len(priors))], numbers)


def _offsets(graph: PoseGraph, count: int) -> list[NDArray[np.int64]]:
    """Where a sensor sits, by the number of its parameters: in space alone, at the node."""
    return [] if graph.planar else [np.zeros(count, np.int64)]


def _lines(tag: str, ids: list[NDArray[np.int64]], numbers: Array) -> Iterator[str]:
    rows = numbers.tolist()
    for k, row in zip(zip(*(i.tolist() for i in ids), strict=True), rows, strict=True):
        yield f"{tag} {' '.join(map(str, k))} {' '.join(map(repr, row))}"


def _triangles(matrices: Array) -> Array:
    rows, columns = np.triu_indices(matrices.shape[-1])
    return np.asarray(matrices[:, rows, columns])


def _spatial(information: Array) -> Array:
    order = SWAP_ROTATION_TRANSLATION
    return _triangles(information[:, order[:, None], order])


def _with_quaternions(poses: Array) -> Array:
    return np.hstack([poses[:, :3, 3], rotation_to_quaternion(poses[:, :3, :3])])


def cartesian(sightings: Sightings) -> Sightings:
    """Bearings and ranges as positions, their information carried over to first order."""
    bearing, reach = sightings.measured[:, 0], sightings.measured[:, 1]
    cos, sin = np.cos(bearing), np.sin(bearing)
    safe = np.where(sightings.polar, reach, 1.0)
    # Derivative of bearing and range by x and y.
    turn = np.stack([np.stack([-sin / safe, cos / safe], -1), np.stack([cos, sin], -1)], -2)
    carried = np.swapaxes(turn, 1, 2) @ sightings.information @ turn
    polar = sightings.polar[:, None]
    return Sightings(
        sightings.node_ids,
        sightings.landmark_ids,
        np.where(polar, np.stack([reach * cos, reach * sin], -1), sightings.measured),
        np.where(polar[..., None], carried, sightings.information),
        np.zeros_like(sightings.polar),
    )
