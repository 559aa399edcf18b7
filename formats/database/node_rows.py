"""Nodes as rows, both ways: RTAB-Map's and our own."""

from __future__ import annotations

import functools
import json
import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from formats.database.blobs import doubles, matrix_to_blob, pose_to_blob, stacked_doubles
from formats.database.environment_rows import (
    blob_to_gps,
    blob_to_readings,
    gps_to_blob,
    readings_to_blob,
)
from formats.database.scan_blobs import scan_without_points
from mapmyworld.errors import MapError
from mapmyworld.geometry.rigid import between
from mapmyworld.geometry.rotations import rotation_to_roll_pitch_yaw
from mapmyworld.types import Node, NodeData, RgbdImage

INSERT_NODE = (
    "INSERT INTO Node (id, map_id, weight, stamp, pose, ground_truth_pose, velocity, label,"
    " gps, env_sensors) VALUES (?,?,?,?,?,?,?,?,?,?)"
)
INSERT_OWN = "INSERT INTO mapmyworld_nodes VALUES (?,?,?,?,?,?,?,?,?,?,?)"
SELECT_OWN = (
    "SELECT own.id, own.session, own.stamp_ns, own.odom_from_base, own.tracked_from_base,"
    " own.weight, own.ground_truth, theirs.gps, theirs.env_sensors"
    " FROM mapmyworld_nodes AS own JOIN Node AS theirs ON theirs.id = own.id"
)
Row = tuple[Any, ...]
_CELLS_TURN = 0.5  # rad of rotation after which a node has a local grid in any case


@dataclass(frozen=True, slots=True)
class StorageOptions:
    """What is stored of a node, and how."""

    image_codec: str = "jpeg"
    image_quality: int = 95
    depth_codec: str = "rvl"
    store_images: bool = True
    local_cells: bool = True
    local_cell_size: float = 0.05
    local_cell_range: float = 5.0
    local_cell_spacing: float = 1.0
    obstacle_lowest: float = 0.08
    obstacle_highest: float = 1.5


def node_rows(items: Sequence[tuple[Node, Node | None]]) -> Iterator[Row]:
    """RTAB-Map's rows of nodes, each with the previous node of the same session."""
    for (node, before), velocity in zip(items, _velocities(items), strict=True):
        truth = None if node.ground_truth is None else pose_to_blob(node.ground_truth)
        label = f"map{node.session}" if before is None else None
        stamp = node.stamp_ns * 1e-9
        pose = pose_to_blob(node.odom_from_base)
        around = (gps_to_blob(node.gps), readings_to_blob(node.readings))
        yield (
            node.id, node.session, node.weight, stamp, pose, truth, velocity, label, *around
        )  # fmt: skip


def _velocities(items: Sequence[tuple[Node, Node | None]]) -> Iterator[bytes | None]:
    """Mean velocity since the previous node: m/s and rad/s (roll, pitch, yaw), base frame."""
    nodes = np.stack([node.odom_from_base for node, _ in items])
    befores = np.stack([(before or node).odom_from_base for node, before in items])
    since = [0 if before is None else node.stamp_ns - before.stamp_ns for node, before in items]
    seconds = np.maximum(since, 1) * 1e-9
    motions = between(befores, nodes)
    turns = rotation_to_roll_pitch_yaw(motions[:, :3, :3])
    velocities = (np.column_stack([motions[:, :3, 3], turns]) / seconds[:, None]).astype("<f4")
    for velocity, passed in zip(velocities, since, strict=True):
        yield velocity.tobytes() if passed > 0 else None


def wants_cells(node: Node, last: Node | None, options: StorageOptions) -> bool:
    """Whether a node gets a local grid; `last` had one. Nodes stand too close for each to.

    A map of RTAB-Map's, at 1 Hz, has one every 0.4 m; with their reach of metres fewer do.
    """
    if not options.local_cells:
        return False
    if last is None or last.session != node.session:
        return True
    a, b = last.odom_from_base, node.odom_from_base
    if math.dist(a[:3, 3], b[:3, 3]) >= options.local_cell_spacing:
        return True
    # The trace of the rotation between them is 1 + 2 cos(angle).
    return float(np.vdot(a[:3, :3], b[:3, :3])) <= 1.0 + 2.0 * math.cos(_CELLS_TURN)


def own_row(node: Node, data: NodeData) -> Row:
    """Our row: double precision, and what RTAB-Map's columns have no place for."""
    truth = None if node.ground_truth is None else _doubles(node.ground_truth)
    images = sum(image.colour is not None for image in data.images)
    depths = sum(image.depth is not None for image in data.images)
    contents = _contents(images, depths, data.scan is not None, data.cloud is not None)
    rest = None if data.scan is None else scan_without_points(data.scan)
    both = data.scan is not None and data.cloud is not None
    return (
        node.id,
        node.session,
        node.stamp_ns,
        _doubles(node.odom_from_base),
        _doubles(node.tracked_from_base),
        node.weight,
        truth,
        contents,
        rest,
        json.dumps([_stamp(image, node) for image in data.images]) if data.images else None,
        matrix_to_blob(data.cloud[None]) if both and data.cloud is not None else None,
    )


@functools.cache
def _contents(images: int, depths: int, scan: bool, cloud: bool) -> str:
    """How much of what a node keeps."""
    return json.dumps({"images": images, "depth": depths, "scan": int(scan), "cloud": int(cloud)})


def _stamp(image: RgbdImage, node: Node) -> int:
    picture = image.colour or image.depth
    return node.stamp_ns if picture is None else picture.stamp_ns


def _doubles(pose: NDArray[np.float64]) -> bytes:
    return np.asarray(pose, "<f8").tobytes()


def nodes_from_own_rows(rows: Sequence[Row]) -> Iterator[Node]:
    """The nodes of rows of `SELECT_OWN`."""
    odom, tracked = (stacked_doubles([row[k] for row in rows], 4) for k in (3, 4))
    if odom is None or tracked is None:
        yield from map(node_from_own_row, rows)
        return
    for row, odom_from_base, tracked_from_base in zip(rows, odom, tracked, strict=True):
        yield _node(row, odom_from_base, tracked_from_base)


def node_from_own_row(row: Row) -> Node:
    """The node of a row of `SELECT_OWN`; raises `MapError` where it is damaged."""
    try:
        return _node(row, doubles(row[3], 4), doubles(row[4], 4))
    except (ValueError, TypeError) as error:
        raise MapError(f"node {row[0]}: a damaged row ({error})") from None


def _node(row: Row, odom: NDArray[np.float64], tracked: NDArray[np.float64]) -> Node:
    node_id, session, stamp_ns, _, _, weight, truth, gps, readings = row
    try:
        return Node(
            id=int(node_id),
            session=int(session),
            stamp_ns=int(stamp_ns),
            odom_from_base=odom,
            tracked_from_base=tracked,
            weight=int(weight),
            ground_truth=None if truth is None else doubles(truth, 4),
            gps=blob_to_gps(gps, f"node {node_id}'s gps"),
            readings=blob_to_readings(readings, f"node {node_id}'s env_sensors"),
        )
    except (ValueError, TypeError) as error:
        raise MapError(f"node {node_id}: a damaged row ({error})") from None
