"""SO(3): rotations as matrices (..., 3, 3), quaternions and rotation vectors."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from mapmyworld.geometry import Array

_SMALL_ANGLE = 1e-9  # rad, below which the series replaces the quotient


def quaternion_to_rotation(quaternion_xyzw: ArrayLike) -> Array:
    """Rotation matrices (..., 3, 3) of quaternions (..., 4) as x, y, z, w; normalised first."""
    q = np.asarray(quaternion_xyzw, np.float64)
    q = q / np.sqrt(np.add.reduce(q * q, axis=-1, keepdims=True))
    k = skew(q[..., :3])
    return np.asarray(np.eye(3) + 2.0 * (q[..., 3, None, None] * k + k @ k))


def rotation_to_quaternion(rotation: ArrayLike) -> Array:
    """Unit quaternions (..., 4) as x, y, z, w with w >= 0, of rotations (..., 3, 3).

    Bar-Itzhack, "New method for extracting the quaternion from a rotation matrix" (2000): the
    largest eigenvector of a symmetric 4x4 matrix, so that a slightly non-orthonormal matrix gives
    the nearest rotation.
    """
    r = np.asarray(rotation, np.float64)
    (xx, xy, xz), (yx, yy, yz), (zx, zy, zz) = ([r[..., i, j] for j in range(3)] for i in range(3))
    k = np.stack(
        [
            np.stack([xx - yy - zz, xy + yx, xz + zx, zy - yz], axis=-1),
            np.stack([xy + yx, yy - xx - zz, yz + zy, xz - zx], axis=-1),
            np.stack([xz + zx, yz + zy, zz - xx - yy, yx - xy], axis=-1),
            np.stack([zy - yz, xz - zx, yx - xy, xx + yy + zz], axis=-1),
        ],
        axis=-2,
    )
    quaternion = np.linalg.eigh(k / 3.0)[1][..., :, -1]
    return np.asarray(np.where(quaternion[..., 3:] < 0, -quaternion, quaternion))


def roll_pitch_yaw_to_rotation(roll: float, pitch: float, yaw: float) -> Array:
    """The rotation (3, 3) about the fixed axes x, then y, then z (REP-103)."""
    cr, sr, cp, sp, cy, sy = (f(a) for a in (roll, pitch, yaw) for f in (np.cos, np.sin))
    return np.array(
        [
            [cy * cp, cy * sp * sr - sy * cr, cy * sp * cr + sy * sr],
            [sy * cp, sy * sp * sr + cy * cr, sy * sp * cr - cy * sr],
            [-sp, cp * sr, cp * cr],
        ]
    )


def rotation_to_roll_pitch_yaw(rotation: ArrayLike) -> Array:
    """Angles (..., 3) of rotations (..., 3, 3) about the fixed axes x, then y, then z."""
    r = np.asarray(rotation, np.float64)
    pitch = np.arctan2(-r[..., 2, 0], np.hypot(r[..., 0, 0], r[..., 1, 0]))
    roll, yaw = np.arctan2(r[..., 2, 1], r[..., 2, 2]), np.arctan2(r[..., 1, 0], r[..., 0, 0])
    return np.stack([roll, pitch, yaw], axis=-1)


def skew(vector: ArrayLike) -> Array:
    """The matrix (..., 3, 3) whose product with u is the cross product `vector x u`.

    `vector` is (..., 3).
    """
    v = np.asarray(vector, np.float64)
    matrix = np.zeros((*v.shape, 3))
    matrix[..., 0, 1], matrix[..., 0, 2], matrix[..., 1, 2] = -v[..., 2], v[..., 1], -v[..., 0]
    return np.asarray(matrix - np.swapaxes(matrix, -1, -2))


def so3_exp(rotation_vector: ArrayLike) -> Array:
    """Rotations (..., 3, 3) of rotation vectors (..., 3) in radians (Rodrigues)."""
    v = np.asarray(rotation_vector, np.float64)
    angle = np.linalg.norm(v, axis=-1)[..., None, None]
    safe = np.maximum(angle, _SMALL_ANGLE)
    small = angle < _SMALL_ANGLE
    k = skew(v)
    first = np.where(small, 1.0, np.sin(safe) / safe)
    second = np.where(small, 0.5, (1.0 - np.cos(safe)) / safe**2)
    return np.asarray(np.eye(3) + first * k + second * (k @ k))


def so3_log(rotation: ArrayLike) -> Array:
    """Rotation vectors (..., 3), of length at most pi, of rotations (..., 3, 3)."""
    r = np.asarray(rotation, np.float64)
    axis = 0.5 * np.stack(
        [r[..., 2, 1] - r[..., 1, 2], r[..., 0, 2] - r[..., 2, 0], r[..., 1, 0] - r[..., 0, 1]],
        axis=-1,
    )
    sine, cosine = np.sqrt(np.sum(axis * axis, axis=-1)), 0.5 * (np.trace(r, 0, -2, -1) - 1.0)
    safe = np.maximum(sine, _SMALL_ANGLE)
    factor = np.where(sine < _SMALL_ANGLE, 1.0, np.arctan2(sine, cosine) / safe)
    vector = np.asarray(axis * factor[..., None])
    if (far := cosine < -0.5).any():  # towards pi the sine indicates ever less of the axis
        vector[far] = _log_by_quaternion(r[far])
    return vector


def _log_by_quaternion(rotation: Array) -> Array:
    quaternion = rotation_to_quaternion(rotation)
    vector, scalar = quaternion[..., :3], quaternion[..., 3]
    length = np.linalg.norm(vector, axis=-1)
    return np.asarray(vector * (2.0 * np.arctan2(length, scalar) / length)[..., None])


def rotation_angle(a_from_b: ArrayLike) -> Array:
    """The angle (...) in radians, 0 to pi, of motions (..., 4, 4) or rotations (..., 3, 3)."""
    r = np.asarray(a_from_b, np.float64)
    axis = [r[..., 2, 1] - r[..., 1, 2], r[..., 0, 2] - r[..., 2, 0], r[..., 1, 0] - r[..., 0, 1]]
    sine = 0.5 * np.sqrt(axis[0] ** 2 + axis[1] ** 2 + axis[2] ** 2)
    cosine = 0.5 * (r[..., 0, 0] + r[..., 1, 1] + r[..., 2, 2] - 1.0)
    return np.asarray(np.arctan2(sine, cosine))
