"""Nodes and their data as rows, both ways."""

from __future__ import annotations

import json
import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from formats.database import pictures
from formats.database.blobs import blob_to_matrix, matrix_to_blob, pose_to_blob
from formats.database.calibration import blob_to_cameras, cameras_to_blob, is_stereo
from formats.database.cells import local_cells
from formats.database.scans import (
    cloud_to_columns,
    columns_to_observation,
    scan_to_columns,
    scan_without_points,
)
from mapmyworld.errors import MapError
from mapmyworld.geometry import between, rotation_angle
from mapmyworld.types import CameraModel, ImageMessage, Node, NodeData, RgbdImage, Scan

INSERT_NODE = (
    "INSERT INTO Node (id, map_id, weight, stamp, pose, ground_truth_pose, velocity, label)"
    " VALUES (?,?,?,?,?,?,?,?)"
)
INSERT_DATA = (
    "INSERT INTO Data (id, image, depth, calibration, scan, scan_info, obstacle_cells,"
    " empty_cells, cell_size, view_point_x, view_point_y, view_point_z)"
    " VALUES (?,?,?,?,?,?,?,?,?,?,?,?)"
)
INSERT_OWN = "INSERT INTO mapmyworld_nodes VALUES (?,?,?,?,?,?,?,?,?,?,?)"
SELECT_OWN = (
    "SELECT id, session, stamp_ns, odom_from_base, tracked_from_base, weight, ground_truth"
    " FROM mapmyworld_nodes"
)
Row = tuple[Any, ...]
_FAST = 1  # zlib level: for cells the default takes six times as long and saves a ninth
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
    local_cell_spacing: float = 0.3


def node_row(node: Node, before: Node | None) -> Row:
    """RTAB-Map's row; `before` is the previous node of the same session."""
    truth = None if node.ground_truth is None else pose_to_blob(node.ground_truth)
    label = f"map{node.session}" if before is None else None
    stamp = node.stamp_ns * 1e-9
    pose = pose_to_blob(node.odom_from_base)
    velocity = None if before is None else _velocity(before, node)
    return (node.id, node.session, node.weight, stamp, pose, truth, velocity, label)


def _velocity(before: Node, node: Node) -> bytes | None:
    """Mean velocity since the previous node: m/s and rad/s (roll, pitch, yaw), base frame."""
    seconds = (node.stamp_ns - before.stamp_ns) * 1e-9
    if seconds <= 0:
        return None
    motion = between(before.odom_from_base, node.odom_from_base)
    turn = _roll_pitch_yaw(motion[:3, :3])
    velocity = np.concatenate([motion[:3, 3], turn]) / seconds
    return velocity.astype("<f4").tobytes()


def _roll_pitch_yaw(r: NDArray[np.float64]) -> tuple[float, float, float]:
    """Angles about the fixed axes x, then y, then z."""
    pitch = math.atan2(-r[2, 0], math.hypot(r[0, 0], r[1, 0]))
    return math.atan2(r[2, 1], r[2, 2]), pitch, math.atan2(r[1, 0], r[0, 0])


def wants_cells(node: Node, last: Node | None, options: StorageOptions) -> bool:
    """Whether a node gets a local grid; `last` had one. Nodes stand too close for each to.

    RTAB-Map's own, at 1 Hz, are some 0.4 m apart.
    """
    if not options.local_cells:
        return False
    if last is None or last.session != node.session:
        return True
    motion = between(last.odom_from_base, node.odom_from_base)
    moved = float(np.linalg.norm(motion[:3, 3])) >= options.local_cell_spacing
    return moved or float(rotation_angle(motion)) >= _CELLS_TURN


def own_row(node: Node, data: NodeData) -> Row:
    """Our row: double precision, and what RTAB-Map's columns have no place for."""
    truth = None if node.ground_truth is None else _doubles(node.ground_truth)
    contents = {"images": sum(image.colour is not None for image in data.images)}
    contents["depth"] = sum(image.depth is not None for image in data.images)
    contents |= {"scan": int(data.scan is not None), "cloud": int(data.cloud is not None)}
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
        json.dumps(contents),
        rest,
        json.dumps([_stamp(image, node) for image in data.images]) if data.images else None,
        matrix_to_blob(data.cloud[None]) if both and data.cloud is not None else None,
    )


def _stamp(image: RgbdImage, node: Node) -> int:
    picture = image.colour or image.depth
    return node.stamp_ns if picture is None else picture.stamp_ns


def _doubles(pose: NDArray[np.float64]) -> bytes:
    return np.asarray(pose, "<f8").tobytes()


def node_from_own_row(row: Row) -> Node:
    """The node of a row of `SELECT_OWN`."""
    node_id, session, stamp_ns, odom, tracked, weight, truth = row
    true_pose = None if truth is None else np.frombuffer(truth, "<f8").reshape(4, 4)
    return Node(
        id=node_id,
        session=session,
        stamp_ns=stamp_ns,
        odom_from_base=np.frombuffer(odom, "<f8").reshape(4, 4),
        tracked_from_base=np.frombuffer(tracked, "<f8").reshape(4, 4),
        weight=weight,
        ground_truth=true_pose,
    )


def data_row(
    node_id: int, data: NodeData, options: StorageOptions, *, with_cells: bool
) -> Row | None:
    """RTAB-Map's row of a node's data; None where there are none."""
    images = data.images if options.store_images else ()
    if not images and data.scan is None and data.cloud is None:
        return None
    colour, depth, calibration = _image_columns(images, options)
    scan, scan_info = _scan_columns(data)
    cells = _cell_columns(data.scan if with_cells else None, options)
    return (node_id, colour, depth, calibration, scan, scan_info, *cells)


def _image_columns(
    images: tuple[RgbdImage, ...], options: StorageOptions
) -> tuple[bytes | None, bytes | None, bytes | None]:
    colours = [image.colour for image in images]
    depths = [image.depth for image in images]
    return (
        _colour_blob(colours, options),
        _depth_blob(depths, options),
        cameras_to_blob(tuple(image.camera for image in images)),
    )


def _colour_blob(colours: list[ImageMessage | None], options: StorageOptions) -> bytes | None:
    """One file for all cameras, side by side; a lone JPEG goes in as it was recorded."""
    there = [colour for colour in colours if colour is not None]
    if not there:
        return None
    if len(colours) == 1 and (there[0].encoded or b"").startswith(pictures.JPEG_MAGIC):
        return there[0].encoded
    joined = _side_by_side([None if c is None else c.pixels() for c in colours], "colour images")
    return pictures.encode_picture(joined, options.image_codec, options.image_quality)


def _depth_blob(depths: list[ImageMessage | None], options: StorageOptions) -> bytes | None:
    if all(depth is None for depth in depths):
        return None
    joined = _side_by_side([None if d is None else d.pixels() for d in depths], "depth images")
    return pictures.encode_depth(joined, options.depth_codec)


def _side_by_side(images: list[NDArray[np.generic] | None], what: str) -> NDArray[np.generic]:
    """All images left to right; a missing one is black."""
    there = [image for image in images if image is not None]
    if len({(image.shape, image.dtype) for image in there}) != 1:
        raise MapError(f"{what} of one node differ in size: RTAB-Map's database keeps equal ones")
    black = np.zeros_like(there[0])
    return np.concatenate([black if image is None else image for image in images], axis=1)


def _scan_columns(data: NodeData) -> tuple[bytes | None, bytes | None]:
    if data.scan is not None:
        return scan_to_columns(data.scan)
    return (None, None) if data.cloud is None else cloud_to_columns(data.cloud)


def _cell_columns(scan: Scan | None, options: StorageOptions) -> Row:
    """Obstacle cells, empty cells, cell size and view point."""
    if scan is None:
        return (None, None, 0.0, 0.0, 0.0, 0.0)
    empty, obstacle = local_cells(scan, options.local_cell_size, options.local_cell_range)
    x, y = (float(value) for value in scan.origin[:2])
    blobs = (matrix_to_blob(obstacle, _FAST), matrix_to_blob(empty, _FAST))
    return (*blobs, options.local_cell_size, x, y, 0.0)


SELECT_DATA = "SELECT image, depth, calibration, scan, scan_info FROM Data WHERE id = ?"


def node_data(row: Row, own: Row | None, stamp_ns: int, what: str) -> NodeData:
    """The data of a row of `SELECT_DATA`.

    `own`: scan_rest, image_stamps, cloud and the depth count of our own table, None in a file
    of RTAB-Map's.
    """
    if any(value is not None and not isinstance(value, bytes) for value in row):
        raise MapError(f"{what}: a column of its data is not a blob")
    image, depth, calibration, scan, scan_info = row
    rest, stamps, both = own or (None, None, None)
    cameras = blob_to_cameras(calibration, f"{what}'s calibration")
    planar, cloud = columns_to_observation(scan, scan_info, rest, f"{what}'s scan")
    if both is not None:
        matrix = blob_to_matrix(both, f"{what}'s cloud")
        cloud = None if matrix is None else np.asarray(matrix, np.float32).reshape(-1, 3)
    times = json.loads(stamps) if stamps else [stamp_ns] * max(len(cameras), 1)
    depth_blob = None if is_stereo(calibration) else depth
    return NodeData(planar, _images(image, depth_blob, cameras, times, what), cloud)


def _images(
    image: bytes | None,
    depth: bytes | None,
    cameras: tuple[CameraModel, ...],
    stamps: list[int],
    what: str,
) -> tuple[RgbdImage, ...]:
    """One a camera; without a calibration there is nothing that the pixels could mean."""
    count = len(cameras)
    colours = _strips(image, count, stamps, f"{what}'s image", pictures.decode_picture, "rgb8")
    depths = _strips(depth, count, stamps, f"{what}'s depth", pictures.decode_depth, "32FC1")
    return tuple(
        RgbdImage(camera, colour, deep)
        for camera, colour, deep in zip(cameras, colours, depths, strict=True)
    )


def _strips(
    data: bytes | None,
    count: int,
    stamps: list[int],
    what: str,
    decode: Callable[[bytes, str], NDArray[Any]],
    encoding: str,
) -> list[ImageMessage | None]:
    """The images of `count` cameras in one file, decoded when asked for."""
    if data is None or len(data) <= 4 or count == 0:
        return [None] * count
    width, height = pictures.image_size(data, what)
    if encoding == "rgb8" and pictures.is_grey(data, what):
        encoding = "mono8"
    strip = width // count

    def pixels_of(index: int) -> Callable[[], NDArray[Any]]:
        return lambda: decode(data, what)[:, index * strip : (index + 1) * strip]

    stamps = stamps + stamps[-1:] * (count - len(stamps))
    return [
        ImageMessage(
            stamp_ns=stamps[i],
            frame_id=f"camera_{i}",
            encoding=encoding,
            width=strip,
            height=height,
            pixels=pixels_of(i),
            encoded=data if count == 1 else None,
        )
        for i in range(count)
    ]
