"""Pose graphs as files: g2o in and out; TORO and GTSAM's landmark format in."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from formats.graph_reading import GraphFile, graph_from_text, read_graph
from formats.whole_files import write_whole
from mapmyworld.geometry import Array
from mapmyworld.geometry.rigid import SWAP_ROTATION_TRANSLATION
from mapmyworld.geometry.rotations import rotation_to_quaternion
from mapmyworld.types.pose_graph import PoseGraph, Sightings

__all__ = [
    "GraphFile",
    "cartesian",
    "graph_from_text",
    "read_graph",
    "text_from_graph",
    "write_graph",
]


def write_graph(path: Path, graph: PoseGraph) -> None:
    """A g2o file; every number survives the round trip to the last bit but for quaternions."""
    write_whole(path, text_from_graph(graph))


def text_from_graph(graph: PoseGraph) -> str:
    """The graph as g2o text: vertices, landmarks, fixed nodes, edges, priors."""
    lines = list(_planar_lines(graph) if graph.planar else _spatial_lines(graph))
    return "".join(f"{line}\n" for line in lines)


def _planar_lines(graph: PoseGraph) -> Iterator[str]:
    yield from _lines("VERTEX_SE2", [graph.ids], graph.map_from_node)
    landmark_ids = graph.landmark_ids + _shift(graph)
    yield from _lines("VERTEX_XY", [landmark_ids], graph.landmarks)
    yield from (f"FIX {k}" for k in graph.fixed_ids.tolist())
    edges = graph.edges
    numbers = np.hstack([edges.i_from_j, _triangles(edges.information)])
    yield from _lines("EDGE_SE2", [edges.from_ids, edges.to_ids], numbers)
    sightings = cartesian(graph.sightings)
    numbers = np.hstack([sightings.measured, _triangles(sightings.information)])
    ends = [sightings.node_ids, sightings.landmark_ids + _shift(graph)]
    yield from _lines("EDGE_SE2_XY", ends, numbers)
    priors = graph.priors
    numbers = np.hstack([priors.map_from_node, _triangles(priors.information)])
    yield from _lines("EDGE_PRIOR_SE2", [priors.ids], numbers)


def _spatial_lines(graph: PoseGraph) -> Iterator[str]:
    if len(graph.sightings) or len(graph.priors):
        yield "PARAMS_SE3OFFSET 0 0 0 0 0 0 0 1"
    yield from _lines("VERTEX_SE3:QUAT", [graph.ids], _with_quaternions(graph.map_from_node))
    landmark_ids = graph.landmark_ids + _shift(graph)
    yield from _lines("VERTEX_TRACKXYZ", [landmark_ids], graph.landmarks)
    yield from (f"FIX {k}" for k in graph.fixed_ids.tolist())
    edges = graph.edges
    numbers = np.hstack([_with_quaternions(edges.i_from_j), _spatial(edges.information)])
    yield from _lines("EDGE_SE3:QUAT", [edges.from_ids, edges.to_ids], numbers)
    sightings = graph.sightings
    offset = np.zeros(len(sightings), np.int64)
    ends = [sightings.node_ids, sightings.landmark_ids + _shift(graph), offset]
    numbers = np.hstack([sightings.measured, _triangles(sightings.information)])
    yield from _lines("EDGE_SE3_TRACKXYZ", ends, numbers)
    priors = graph.priors
    numbers = np.hstack([_with_quaternions(priors.map_from_node), _spatial(priors.information)])
    yield from _lines("EDGE_SE3_PRIOR", [priors.ids, np.zeros(len(priors), np.int64)], numbers)


def _shift(graph: PoseGraph) -> int:
    """What landmarks' ids are raised by where they would clash with nodes': g2o has one series."""
    if len(np.intersect1d(graph.ids, graph.landmark_ids)) == 0 and (graph.landmark_ids >= 0).all():
        return 0
    low = int(graph.landmark_ids.min(initial=0))
    return int(graph.ids.max(initial=0)) + 1 - min(low, 0)


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
