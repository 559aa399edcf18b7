"""Landmarks as nodes: a point is a node whose orientation is held, so that blocks stay alike.

The residual of a sighting is the landmark's position in the node's frame, or its bearing and
range, less the measured one; the rest of the residual keeps the landmark's orientation at zero.
"""

from __future__ import annotations

import numpy as np

from mapmyworld.backend.connected_components import positions
from mapmyworld.geometry import Array, Index
from mapmyworld.geometry.planar import (
    between_planar,
    planar_to_matrix,
    transform_points_planar,
    wrap_angle,
)
from mapmyworld.geometry.rigid import between, transform_points
from mapmyworld.geometry.rotations import skew, so3_log
from mapmyworld.types.pose_graph import Sightings

POINT, POLAR = 1, 2
"""Kinds of edges that are sightings; edges between poses are 0."""


def sighting_residuals(
    planar: bool, tails: Array, heads: Array, measured: Array, kinds: Index
) -> Array:
    """Residuals (K, d) of sightings, in the order of the tangent; m and rad.

    `tails` and `heads` (K, 3 or 4, 4) are map_from_node and the landmarks as poses, `measured` of
    the same shape and `kinds` (K,) those of `as_edges`.
    """
    local, residuals = _local(planar, tails, heads), np.zeros((len(tails), 3 if planar else 6))
    if not planar:
        residuals[:, :3] = so3_log(heads[:, :3, :3])
        residuals[:, 3:] = local - measured[:, :3, 3]
        return residuals
    residuals[:, :2] = local - measured[:, :2]
    polar = kinds == POLAR
    bearing = np.arctan2(local[polar, 1], local[polar, 0])
    residuals[polar, 0] = wrap_angle(bearing - measured[polar, 0])
    residuals[polar, 1] = np.hypot(*local[polar].T) - measured[polar, 1]
    residuals[:, 2] = wrap_angle(heads[:, 2])
    return residuals


def sighting_derivatives(
    planar: bool, tails: Array, heads: Array, kinds: Index
) -> tuple[Array, Array]:
    """How residuals of sightings change: with their nodes (K, d, m), with the landmarks (K, d, d).

    `tails`, `heads` (K, 3 or 4, 4) and `kinds` (K,) as of `sighting_residuals`; d = 2 and m = 3 in
    the plane, else 3 and 6.
    """
    local, still = _local(planar, tails, heads), -np.eye(2 if planar else 3)
    turns = (planar_to_matrix(tails)[:, :2, :2] if planar else tails[:, :3, :3]).swapaxes(1, 2)
    steady = np.tile(still, (len(local), 1, 1))
    if not planar:
        return np.concatenate([skew(local), steady], axis=2), turns
    by_node = np.concatenate([steady, (local[:, ::-1] * [1.0, -1.0])[:, :, None]], axis=2)
    change = np.where((kinds == POLAR)[:, None, None], _polar_change(local), np.eye(2))
    return change @ by_node, change @ turns


def _local(planar: bool, tails: Array, heads: Array) -> Array:
    """Positions (K, 2 or 3) of landmarks in their nodes' frames."""
    if planar:
        return between_planar(tails, heads)[:, :2]
    return between(tails, heads)[:, :3, 3]


def _polar_change(points: Array) -> Array:
    """Derivatives (K, 2, 2) of bearing and range by position."""
    x, y = points.T
    square = np.maximum(x * x + y * y, 1e-12)
    reach = np.sqrt(square)
    rows = [np.column_stack([-y / square, x / square]), np.column_stack([x / reach, y / reach])]
    return np.stack(rows, axis=1)


def as_edges(planar: bool, sightings: Sightings) -> tuple[Array, Array, Index]:
    """Measurements (K, 3 or 4, 4), information (K, d, d) and kinds (K,), shaped like pose edges."""
    count, size = len(sightings), 2 if planar else 3
    if count == 0:  # whatever shape an empty one has
        empty = np.zeros((0, 3) if planar else (0, 4, 4))
        return empty, np.zeros((0, 3, 3) if planar else (0, 6, 6)), np.zeros(0, np.int64)
    information = np.tile(np.eye(3 if planar else 6), (count, 1, 1))
    kinds = np.where(sightings.polar, POLAR, POINT).astype(np.int64)
    if planar:
        information[:, :size, :size] = sightings.information
        return np.column_stack([sightings.measured, np.zeros(count)]), information, kinds
    information[:, size:, size:] = sightings.information
    measured = np.tile(np.eye(4), (count, 1, 1))
    measured[:, :3, 3] = sightings.measured
    return measured, information, kinds


def first_places(
    planar: bool, poses: Array, node_ids: Index, landmark_ids: Index, sightings: Sightings
) -> Array:
    """Landmarks as poses (L, 3 or 4, 4), each where its first sighting puts it.

    `poses` (M, 3 or 4, 4) are map_from_node, the first N those of the ascending `node_ids` (N,);
    `landmark_ids` (L,) ascend as well.
    """
    order = np.lexsort((sightings.node_ids, sightings.landmark_ids))
    seen, first = np.unique(sightings.landmark_ids[order], return_index=True)
    chosen = sightings.chosen(order[first])
    tails, at = poses[positions(node_ids, chosen.node_ids)], positions(landmark_ids, seen)
    if planar:
        bearing, reach = chosen.measured.T
        direct = np.column_stack([reach * np.cos(bearing), reach * np.sin(bearing)])
        local = np.where(chosen.polar[:, None], direct, chosen.measured)
        places = np.zeros((len(landmark_ids), 3))
        places[at, :2] = transform_points_planar(tails, local[:, None])[:, 0]
        return places
    places = np.tile(np.eye(4), (len(landmark_ids), 1, 1))
    places[at, :3, 3] = transform_points(tails, chosen.measured[:, None])[:, 0]
    return places
