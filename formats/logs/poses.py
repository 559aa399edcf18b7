"""Poses as messages hold them, as matrices."""

from __future__ import annotations

import math
from collections.abc import Sequence
from struct import Struct

import numpy as np
from numpy.typing import NDArray

_MATRIX = Struct("16d").pack


def pose_matrix(values: Sequence[float]) -> NDArray[np.float64]:
    """The matrix (4, 4) of x y z qx qy qz qw; a zero quaternion, never set, means no rotation."""
    x, y, z, qx, qy, qz, qw = values
    square = qx * qx + qy * qy + qz * qz + qw * qw
    s = 2.0 / square if square else 0.0
    xx, yy, zz = s * qx * qx, s * qy * qy, s * qz * qz
    xy, xz, yz = s * qx * qy, s * qx * qz, s * qy * qz
    wx, wy, wz = s * qw * qx, s * qw * qy, s * qw * qz
    rows = _MATRIX(
        1.0 - yy - zz, xy - wz, xz + wy, x,
        xy + wz, 1.0 - xx - zz, yz - wx, y,
        xz - wy, yz + wx, 1.0 - xx - yy, z,
        0.0, 0.0, 0.0, 1.0,
    )  # fmt: skip
    return np.frombuffer(rows).reshape(4, 4)  # read-only, and half the time of np.array


def planar_pose(x: float, y: float, yaw: float) -> NDArray[np.float64]:
    """The matrix (4, 4), formed as readers of ROS messages form it from a quaternion."""
    return pose_matrix((x, y, 0.0, 0.0, 0.0, math.sin(0.5 * yaw), math.cos(0.5 * yaw)))
