"""Nodes, and their GPS fixes, as rows, both ways: RTAB-Map's and our own."""

from __future__ import annotations

import json
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from formats.database.blobs import doubles, matrix_to_blob, pose_to_blob
from formats.database.connection import Row
from formats.database.scan_blobs import scan_to_blob
from formats.decimal_stamps import nanoseconds_from_text
from mapmyworld.errors import MapError
from mapmyworld.geometry.rigid import between
from mapmyworld.geometry.rotations import rotation_to_roll_pitch_yaw
from mapmyworld.types import GpsMessage, Node, NodeData, RgbdImage

INSERT_NODE = (
    "INSERT INTO Node (id, map_id, weight, stamp, pose, ground_truth_pose, velocity, label, gps)"
    " VALUES (?,?,?,?,?,?,?,?,?)"
)
INSERT_OWN = "INSERT INTO mapmyworld_nodes VALUES (?,?,?,?,?,?,?,?,?,?)"
SELECT_OWN = (
    "SELECT own.id, own.session, own.stamp_ns, own.odom_from_base, own.tracked_from_base,"
    " own.weight, own.ground_truth, theirs.gps"
    " FROM mapmyworld_nodes AS own JOIN Node AS theirs ON theirs.id = own.id"
)


@dataclass(frozen=True, slots=True)
class StorageOptions:
    """What is stored of a node, and how."""

    image_codec: str = "jpeg"
    image_quality: int = 95
    depth_codec: str = "png"
    store_images: bool = True


def node_row(node: Node, before: Node | None) -> Row:
    """RTAB-Map's row of a node; `before` is the previous one of the same session."""
    truth = None if node.ground_truth is None else pose_to_blob(node.ground_truth)
    label = f"map{node.session}" if before is None else None
    pose, velocity = pose_to_blob(node.odom_from_base), _velocity(node, before)
    fix, gps, stamp = node.gps, None, node.stamp_ns * 1e-9
    if fix is not None:  # 48 bytes, the bearing unknown: 0
        place = (fix.longitude, fix.latitude, fix.altitude)
        gps = np.array([fix.stamp_ns * 1e-9, *place, fix.error, 0.0], "<f8").tobytes()
    return (node.id, node.session, node.weight, stamp, pose, truth, velocity, label, gps)


def _velocity(node: Node, before: Node | None) -> bytes | None:
    """Mean velocity since the previous node: m/s and rad/s (roll, pitch, yaw), base frame."""
    if before is None or node.stamp_ns <= before.stamp_ns:
        return None
    motion = between(before.odom_from_base, node.odom_from_base)
    turn = rotation_to_roll_pitch_yaw(motion[:3, :3])
    seconds = (node.stamp_ns - before.stamp_ns) * 1e-9
    return (np.concatenate([motion[:3, 3], turn]) / seconds).astype("<f4").tobytes()


def own_row(node: Node, data: NodeData) -> Row:
    """Our row: double precision, and what RTAB-Map's columns have no place for."""
    truth = None if node.ground_truth is None else _doubles(node.ground_truth)
    # RTAB-Map's columns do not hold the beams that came back with nothing.
    rest = data.scan and scan_to_blob(replace(data.scan, points=data.scan.points[:0]))
    both = data.scan is not None and data.cloud is not None
    return (
        node.id,
        node.session,
        node.stamp_ns,
        _doubles(node.odom_from_base),
        _doubles(node.tracked_from_base),
        node.weight,
        truth,
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
    """The node of a row of `SELECT_OWN`; raises `MapError` where it is damaged."""
    node_id, session, stamp_ns, odom, tracked, weight, truth, gps = row
    try:
        return Node(
            id=int(node_id),
            session=int(session),
            stamp_ns=int(stamp_ns),
            odom_from_base=doubles(odom, 4),
            tracked_from_base=doubles(tracked, 4),
            weight=int(weight),
            ground_truth=None if truth is None else doubles(truth, 4),
            gps=blob_to_gps(gps, f"node {node_id}'s gps"),
        )
    except (ValueError, TypeError) as error:
        raise MapError(f"node {node_id}: a damaged row ({error})") from None


_LATEST_S = 9e9  # a stamp's seconds beyond which nanoseconds leave 64 bits


def nanoseconds(stamp: float | None) -> int:
    """A stamp in float seconds as the decimal number that was meant: microseconds survive.

    Raises `MapError` for one beyond sense.
    """
    seconds = float(stamp or 0.0)
    if not abs(seconds) < _LATEST_S:
        raise MapError(f"a stamp of {seconds} s")
    return nanoseconds_from_text(repr(seconds))


def blob_to_gps(blob: bytes | None, what: str) -> GpsMessage | None:
    """The fix; None where there is none, which a stamp of 0 says as well.

    Raises `MapError` where it is damaged; `what` names it.
    """
    if not blob:
        return None
    if len(blob) != 48:
        raise MapError(f"{what}: a GPS fix takes 48 bytes, not {len(blob)}")
    stamp, longitude, latitude, altitude, error, _ = np.frombuffer(blob, "<f8").tolist()
    if not stamp > 0:
        return None
    return GpsMessage(nanoseconds(stamp), "", latitude, longitude, altitude, error)
