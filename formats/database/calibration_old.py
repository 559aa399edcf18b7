"""Calibrations as RTAB-Map stored them from 0.11.2 until 0.18, as the records of today."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from formats.database.blobs import matrices_from_floats
from formats.database.calibration import camera_record, stereo_record
from mapmyworld.errors import MapError
from mapmyworld.types import CameraModel

_MONO, _STEREO = 18, 19  # float32: fx fy cx cy (baseline) width height, base_from_camera (12)


def modernised(blob: bytes | None, what: str) -> bytes | None:
    """The same cameras in the format of 0.18 and later; None for none.

    Raises `MapError` where they are damaged; `what` names them.
    """
    if not blob:
        return None
    floats = np.frombuffer(blob[: len(blob) // 4 * 4], "<f4")
    if not np.isfinite(floats).all() or (len(floats) % _MONO and len(floats) != _STEREO):
        raise MapError(
            f"{what}: {len(blob)} bytes are no calibration of RTAB-Map before 0.18: convert the"
            ' file with `rtabmap-reprocess --Db/TargetVersion "" old.db new.db`'
        )
    if len(floats) == _STEREO:
        camera, baseline = _camera(np.delete(floats, 4)), float(floats[4])
        return stereo_record(camera, baseline)
    return b"".join(camera_record(_camera(row)) for row in floats.reshape(-1, _MONO))


def _camera(row: NDArray[np.float32]) -> CameraModel:
    fx, fy, cx, cy, width, height = (float(value) for value in row[:6])
    intrinsics = np.array([[fx, 0.0, cx], [0.0, fy, cy], [0.0, 0.0, 1.0]])
    mount = matrices_from_floats(row[None, 6:])[0]
    if not mount[:3].any():
        mount = np.eye(4)
    return CameraModel(int(width), int(height), intrinsics, "", np.zeros(0), mount)
