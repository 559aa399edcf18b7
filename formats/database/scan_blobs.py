"""Scans as blobs: compact ones of every tracked frame, and RTAB-Map's of the nodes."""

from __future__ import annotations

import dataclasses
import math
import struct

import numpy as np
from numpy.typing import NDArray

from formats.database.blobs import (
    FAST,
    STORED,
    blob_to_matrix,
    blob_to_pose,
    matrix_to_blob,
)
from mapmyworld.errors import MapError
from mapmyworld.geometry.planar import (
    invert_planar,
    matrix_to_planar,
    planar_to_matrix,
    transform_points_planar,
    wrap_angle,
)
from mapmyworld.geometry.rigid import transform_points
from mapmyworld.types import Scan

# counts of points and missing beams, range_max, angle_increment, origin x, y, yaw
_HEADER = struct.Struct("<2I5d")
_XY, _XYZ = 1, 5
# RTAB-Map's scan formats -> whether a point has a z.
_HAS_Z = {1: False, 2: False, 3: False, 4: False, **dict.fromkeys(range(5, 13), True)}
# Format 0 is guessed from the channels: 2 and 5 (with normals) are planar.
_PLANAR_CHANNELS = {2, 5}
_SCAN_INFO_FLOATS = 19


def scan_to_blob(scan: Scan) -> bytes:
    """One frame's scan, as it is: packing would save a fifth and cost ten times the writing."""
    counts, origin = (len(scan.points), len(scan.missing)), scan.origin.tolist()
    head = _HEADER.pack(*counts, scan.range_max, scan.angle_increment, *origin)
    return head + b"".join(np.asarray(a, "<f4").tobytes() for a in (scan.points, scan.missing))


def blob_to_scan(blob: bytes, what: str) -> Scan:
    """The scan of `scan_to_blob`; raises `MapError` where it is damaged; `what` names it."""
    if not isinstance(blob, bytes) or len(blob) < _HEADER.size:
        raise MapError(f"{what}: not the bytes of a scan, or too few of them")
    points, missing, range_max, increment, *origin = _HEADER.unpack_from(blob)
    if len(blob) != _HEADER.size + 4 * (2 * points + missing):
        raise MapError(f"{what}: {points} points and {missing} bearings in {len(blob)} bytes")
    floats = np.frombuffer(blob, "<f4", offset=_HEADER.size)
    if not np.isfinite([increment, *origin]).all() or math.isnan(range_max):
        raise MapError(f"{what}: a scan whose step, reach or place is no number")
    if not np.isfinite(floats).all():
        raise MapError(f"{what}: a scan with points that are no numbers")
    returns = floats[: 2 * points].reshape(points, 2)
    return Scan(returns, np.array(origin), floats[2 * points :], range_max, increment)


def scan_to_columns(scan: Scan) -> tuple[bytes | None, bytes]:
    """`Data.scan` and `Data.scan_info` of a planar scan."""
    points = transform_points_planar(invert_planar(scan.origin), scan.points)
    missing = wrap_angle(scan.missing.astype(np.float64) - scan.origin[2])
    bearings = np.concatenate([np.arctan2(points[:, 1], points[:, 0]), missing])
    low, high = (bearings.min(), bearings.max()) if len(bearings) else (0.0, 0.0)
    mount = planar_to_matrix(scan.origin)[:3].ravel().tolist()
    head = _planar_head(scan, float(low), float(high), len(points))
    # Measured points hardly shrink: packing saves a fifteenth and is a tenth of all writing.
    blob = matrix_to_blob(points.astype(np.float32)[None], STORED)
    return blob, np.array([*head, *mount], "<f4").tobytes()


def _planar_head(
    scan: Scan, low: float, high: float, count: int
) -> tuple[float, float, float, float, float, float, float]:
    """The first 28 of the 76 bytes; the angles leave room for every point at the increment."""
    step = scan.angle_increment
    high = max(high, low + step * max(count - 1, 1))
    most = math.ceil((high - low) / step) + 1 if step > 0 else count
    reach = scan.range_max
    if not math.isfinite(reach):  # not said by the log
        reach = float(np.linalg.norm(scan.points - scan.origin[:2], axis=1).max(initial=1.0))
    return _XY, 0.0, reach, low, high, step, most


def cloud_to_columns(cloud: NDArray[np.float32]) -> tuple[bytes | None, bytes]:
    """`Data.scan` and `Data.scan_info` of a 3D scan (N, 3) in the base frame."""
    points = np.asarray(cloud, np.float32)
    reach = float(np.linalg.norm(points, axis=1).max()) if len(points) else 0.0
    head = (_XYZ, 0.0, reach, 0.0, 0.0, 0.0, len(points))
    info = np.array([*head, *np.eye(3, 4).ravel().tolist()], "<f4").tobytes()
    return matrix_to_blob(points[None], FAST), info


def columns_to_observation(
    scan: bytes | None, info: bytes | None, rest: bytes | None, what: str
) -> tuple[Scan | None, NDArray[np.float32] | None]:
    """A node's planar scan, or 3D scan (N, 3), in the base frame; None for what it is not."""
    matrix = blob_to_matrix(scan, what)
    if matrix is None:
        return (blob_to_scan(rest, what), None) if rest is not None else (None, None)
    values, base_from_lidar = _scan_info(info, what)
    points, planar = _points(matrix, round(float(values[0])), what)
    if not planar:
        return None, transform_points(base_from_lidar, points).astype(np.float32)
    origin = matrix_to_planar(base_from_lidar)
    if rest is not None:
        ours = blob_to_scan(rest, what)
        in_base = transform_points_planar(ours.origin, points[:, :2]).astype(np.float32)
        return dataclasses.replace(ours, points=in_base), None
    lifted = transform_points(base_from_lidar, points)[:, :2].astype(np.float32)
    missing = np.empty(0, np.float32)
    return Scan(lifted, origin, missing, float(values[2]), float(values[5])), None


def _scan_info(info: bytes | None, what: str) -> tuple[NDArray[np.float32], NDArray[np.float64]]:
    """The seven leading figures, and base_from_lidar (4, 4)."""
    if info is None or len(info) == 0:
        return np.zeros(7, np.float32), np.eye(4)
    if len(info) != 4 * _SCAN_INFO_FLOATS:
        raise MapError(f"{what}: scan_info takes 76 bytes, not {len(info)}")
    floats = np.frombuffer(info, "<f4")
    mount = blob_to_pose(floats[-12:].tobytes(), what)
    values = floats[:7]
    if not np.isfinite(values).all():
        raise MapError(f"{what}: scan_info that is not finite")
    return values, np.eye(4) if mount is None else mount


def _points(matrix: NDArray[np.generic], kind: int, what: str) -> tuple[NDArray[np.float64], bool]:
    """Finite points (N, 3) of a scan matrix, organised or not, and whether they are planar."""
    channels = matrix.shape[2]
    if matrix.dtype != np.float32 or channels < 2:
        raise MapError(f"{what}: a scan of {channels} channels of {matrix.dtype} is not one")
    planar = not _HAS_Z[kind] if kind in _HAS_Z else channels in _PLANAR_CHANNELS
    if not planar and channels < 3:
        raise MapError(f"{what}: a 3D scan of {channels} channels is not one")
    rows = matrix.reshape(-1, channels)
    points = np.zeros((len(rows), 3))
    used = 2 if planar else 3
    points[:, :used] = rows[:, :used]
    return points[np.isfinite(points).all(axis=1)], planar
