"""RTAB-Map's calibration blob: one record a camera, mono or stereo."""

from __future__ import annotations

import struct

import numpy as np
from numpy.typing import NDArray

from formats.database.blobs import blob_to_pose, pose_to_blob
from mapmyworld.errors import MapError
from mapmyworld.types import CameraModel

_MONO = struct.Struct("<11i")  # version (3), type, width, height, nK, nD, nR, nP, nL
_STEREO = struct.Struct("<10i")  # version (3), type, nR, nT, nE, nF, bytes left, bytes right
_VERSION = (0, 20, 0)
# Where the fisheye's k1..k4 stand among RTAB-Map's six coefficients.
_FISHEYE_SLOTS = [0, 1, 4, 5]
_LEAST_FOCAL = 0.1  # pixels


def camera_record(camera: CameraModel) -> bytes:
    """Of one of the cameras whose images stand side by side: a blob is their records in a row."""
    distortion = _stored_distortion(camera)
    projection = np.column_stack([camera.intrinsics, np.zeros(3)])
    sizes = (9, len(distortion), 9, 12, 12)
    head = _MONO.pack(*_VERSION, 0, camera.width, camera.height, *sizes)
    doubles = [camera.intrinsics.ravel(), distortion, np.eye(3).ravel(), projection.ravel()]
    mount = pose_to_blob(camera.base_from_camera)
    return head + np.concatenate(doubles).astype("<f8").tobytes() + mount


def _stored_distortion(camera: CameraModel) -> NDArray[np.float64]:
    """Coefficients at one of the lengths that RTAB-Map knows: 0, 4, 5, 6 (fisheye), 8, 12, 14."""
    given = np.asarray(camera.distortion, np.float64).ravel()
    if camera.distortion_model == "equidistant":
        fisheye = np.zeros(6)
        fisheye[_FISHEYE_SLOTS[: len(given)]] = given[:4]
        return fisheye
    if not given.any():
        return np.zeros(0)
    length = next((n for n in (4, 5, 8, 12, 14) if n >= len(given)), 14)
    stored = np.zeros(length)
    stored[: len(given)] = given[:length]
    return stored


def blob_to_eyes(blob: bytes | None, what: str) -> tuple[tuple[CameraModel, float | None], ...]:
    """The cameras of a blob, with focal length times baseline [pixel metres] of stereo pairs.

    That is 0 where the file does not say, and None of a camera alone: of a pair, `Data.depth` holds
    the right image.
    """
    eyes, at = list[tuple[CameraModel, float | None]](), 0
    while blob is not None and at < len(blob):
        camera, scale, at = _read_any(blob, at, what)
        eyes.append((camera, scale))
    return tuple(eyes)


def _read_any(blob: bytes, at: int, what: str) -> tuple[CameraModel, float | None, int]:
    if len(blob) - at < _STEREO.size:
        raise MapError(f"{what}: the calibration ends within a record")
    if struct.unpack_from("<i", blob, at + 12)[0] == 0:
        camera, _, end = _read_mono(blob, at, what)
        return camera, None, end
    *_, n_r, n_t, n_e, n_f, left, right = _STEREO.unpack_from(blob, at)
    if min(n_r, n_t, n_e, n_f, left, right) < 0 or max(n_r, n_t, n_e, n_f) > 9:
        raise MapError(f"{what}: a stereo calibration with impossible sizes")
    start = at + _STEREO.size + 8 * (n_r + n_t + n_e + n_f)
    camera, near, middle = _read_mono(blob, start, what)
    _, far, end = _read_mono(blob, middle, what)
    if middle != start + left or end != middle + right:
        raise MapError(f"{what}: the calibration's sizes do not add up")
    if not (near[0, 0] > 0 and far[0, 0] > 0):
        return camera, 0.0, end
    # RTAB-Map's baseline: left Tx / left fx - right Tx / right fx, with Tx = P[0, 3].
    baseline = near[0, 3] / near[0, 0] - far[0, 3] / far[0, 0]
    return camera, max(0.0, float(near[0, 0] * baseline)), end


def _read_mono(blob: bytes, at: int, what: str) -> tuple[CameraModel, NDArray[np.float64], int]:
    """The camera, its P (3, 4), zeros where there is none, and where its record ends."""
    if len(blob) - at < _MONO.size:
        raise MapError(f"{what}: the calibration ends within a record")
    *_, width, height, n_k, n_d, n_r, n_p, n_l = _MONO.unpack_from(blob, at)
    allowed = ((0, 9), (0, 4, 5, 6, 8, 12, 14), (0, 9), (0, 12), (0, 12))
    sizes = (n_k, n_d, n_r, n_p, n_l)
    if any(n not in known for n, known in zip(sizes, allowed, strict=True)):
        raise MapError(f"{what}: a calibration with matrices of {sizes} numbers")
    longest = CameraModel.longest_side
    if not (0 <= width <= longest and 0 <= height <= longest):
        raise MapError(f"{what}: a calibration of {width} x {height} pixels")
    at += _MONO.size
    end = at + 8 * sum(sizes[:4]) + 4 * n_l
    if end > len(blob):
        raise MapError(f"{what}: the calibration ends within a record")
    doubles = np.frombuffer(blob, "<f8", sum(sizes[:4]), at)
    k, d, _, p = np.split(doubles, np.cumsum(sizes[:3]))
    mount = blob_to_pose(blob[end - 48 : end], what) if n_l else None
    camera = _camera(width, height, k, d, p, np.eye(4) if mount is None else mount)
    focal = np.diagonal(camera.intrinsics)[:2]
    if not (np.isfinite(doubles).all() and (focal > _LEAST_FOCAL).all()):
        raise MapError(f"{what}: a calibration with focal lengths of {focal} pixels")
    return camera, p.reshape(3, 4) if len(p) else np.zeros((3, 4)), end


def _camera(
    width: int,
    height: int,
    k: NDArray[np.float64],
    d: NDArray[np.float64],
    p: NDArray[np.float64],
    base_from_camera: NDArray[np.float64],
) -> CameraModel:
    """Intrinsics from P where it is there, as RTAB-Map takes them, else K."""
    intrinsics = np.eye(3)
    if len(p):
        intrinsics = p.reshape(3, 4)[:, :3].copy()
    elif len(k):
        intrinsics = k.reshape(3, 3).copy()
    if len(d) == 6:
        model, distortion = "equidistant", d[_FISHEYE_SLOTS]
    else:
        model, distortion = ("plumb_bob" if len(d) <= 5 else "rational_polynomial"), d
    if not distortion.any():
        model, distortion = "", np.zeros(0)
    return CameraModel(width, height, intrinsics, model, np.array(distortion), base_from_camera)
