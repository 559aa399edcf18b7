"""Rigid motions as arrays: SE(2) as `(..., 3)` rows `x, y, yaw`, SE(3) as `(..., 4, 4)` matrices.

Every function broadcasts over leading axes. Tangent vectors of SE(3) are ordered rotation, then
translation, and perturb on the right: `pose @ se3_exp(tangent)` (gtsam's convention).
Formulas: Sola, Deray, Atchuthan, "A micro Lie theory for state estimation in robotics" (2018).
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import ArrayLike, NDArray

Array = NDArray[np.float64]

# Rows of a rotation-first SE(3) tangent that a planar motion uses, in the order x, y, yaw.
PLANAR_IN_TANGENT = np.array([3, 4, 2])
# Takes a translation-first tangent (g2o, RTAB-Map) to a rotation-first one, and back.
SWAP_ROTATION_TRANSLATION = np.array([3, 4, 5, 0, 1, 2])
_SMALL_ANGLE = 1e-9  # rad, below which the series replaces the quotient


def wrap_angle(angle: ArrayLike) -> Array:
    """The same angles in (-pi, pi]."""
    angle = np.asarray(angle, dtype=np.float64)
    return np.asarray(np.pi - np.mod(np.pi - angle, 2.0 * np.pi))


def _wrap_one(angle: float) -> float:
    return math.pi - (math.pi - angle) % (2.0 * math.pi)


def _compose_one(ax: float, ay: float, ayaw: float, bx: float, by: float, byaw: float) -> Array:
    """One pair of planar motions, ten times as fast as arrays of one."""
    c, s = math.cos(ayaw), math.sin(ayaw)
    return np.array([ax + c * bx - s * by, ay + s * bx + c * by, _wrap_one(ayaw + byaw)])


def compose_planar(a_from_b: ArrayLike, b_from_c: ArrayLike) -> Array:
    """`a_from_c` (..., 3) of two planar motions."""
    a, b = np.asarray(a_from_b, np.float64), np.asarray(b_from_c, np.float64)
    if a.ndim == b.ndim == 1:
        return _compose_one(*a.tolist(), *b.tolist())
    cos, sin = np.cos(a[..., 2]), np.sin(a[..., 2])
    return np.stack(
        [
            a[..., 0] + cos * b[..., 0] - sin * b[..., 1],
            a[..., 1] + sin * b[..., 0] + cos * b[..., 1],
            wrap_angle(a[..., 2] + b[..., 2]),
        ],
        axis=-1,
    )


def invert_planar(a_from_b: ArrayLike) -> Array:
    """`b_from_a` (..., 3) of a planar motion."""
    a = np.asarray(a_from_b, np.float64)
    if a.ndim == 1:
        x, y, yaw = a.tolist()
        c, s = math.cos(yaw), math.sin(yaw)
        return np.array([-c * x - s * y, s * x - c * y, _wrap_one(-yaw)])
    cos, sin = np.cos(a[..., 2]), np.sin(a[..., 2])
    return np.stack(
        [
            -cos * a[..., 0] - sin * a[..., 1],
            sin * a[..., 0] - cos * a[..., 1],
            wrap_angle(-a[..., 2]),
        ],
        axis=-1,
    )


def between_planar(map_from_a: ArrayLike, map_from_b: ArrayLike) -> Array:
    """`a_from_b` (..., 3) of two planar poses."""
    return compose_planar(invert_planar(map_from_a), map_from_b)


def transform_points_planar(a_from_b: ArrayLike, points: ArrayLike) -> Array:
    """Points (..., N, 2) of frame b, expressed in frame a."""
    a, p = np.asarray(a_from_b, np.float64), np.asarray(points, np.float64)
    cos, sin = np.cos(a[..., 2, None]), np.sin(a[..., 2, None])
    return np.stack(
        [
            a[..., 0, None] + cos * p[..., 0] - sin * p[..., 1],
            a[..., 1, None] + sin * p[..., 0] + cos * p[..., 1],
        ],
        axis=-1,
    )


def planar_to_matrix(a_from_b: ArrayLike) -> Array:
    """The SE(3) matrix (..., 4, 4) of a planar motion (..., 3)."""
    a = np.asarray(a_from_b, np.float64)
    matrix = np.zeros((*a.shape[:-1], 4, 4))
    cos, sin = np.cos(a[..., 2]), np.sin(a[..., 2])
    matrix[..., 0, 0], matrix[..., 0, 1] = cos, -sin
    matrix[..., 1, 0], matrix[..., 1, 1] = sin, cos
    matrix[..., 2, 2] = matrix[..., 3, 3] = 1.0
    matrix[..., 0, 3], matrix[..., 1, 3] = a[..., 0], a[..., 1]
    return matrix


def matrix_to_planar(a_from_b: ArrayLike) -> Array:
    """`x, y, yaw` (..., 3) of SE(3) matrices; height, roll and pitch are dropped."""
    m = np.asarray(a_from_b, np.float64)
    yaw = np.arctan2(m[..., 1, 0], m[..., 0, 0])
    return np.stack([m[..., 0, 3], m[..., 1, 3], yaw], axis=-1)


def invert(a_from_b: ArrayLike) -> Array:
    """`b_from_a` (..., 4, 4), by the transpose of the rotation."""
    m = np.asarray(a_from_b, np.float64)
    inverse = np.zeros(m.shape)
    if m.ndim == 2:  # one alone, five times as fast
        inverse[:3, :3], inverse[3, 3] = m[:3, :3].T, 1.0
        inverse[:3, 3] = -(m[:3, 3] @ m[:3, :3])
        return inverse
    rotation = np.swapaxes(m[..., :3, :3], -1, -2)
    inverse[..., :3, :3] = rotation
    inverse[..., :3, 3] = -np.einsum("...ij,...j->...i", rotation, m[..., :3, 3])
    inverse[..., 3, 3] = 1.0
    return inverse


def between(map_from_a: ArrayLike, map_from_b: ArrayLike) -> Array:
    """`a_from_b` (..., 4, 4) of two poses."""
    return np.asarray(invert(map_from_a) @ np.asarray(map_from_b, np.float64))


def transform_points(a_from_b: ArrayLike, points: ArrayLike) -> Array:
    """Points (..., N, 3) of frame b, expressed in frame a."""
    m, p = np.asarray(a_from_b, np.float64), np.asarray(points, np.float64)
    return np.asarray(p @ np.swapaxes(m[..., :3, :3], -1, -2) + m[..., None, :3, 3])


def make_transform(rotation: ArrayLike, translation: ArrayLike) -> Array:
    """The matrix (..., 4, 4) of a rotation (..., 3, 3) and a translation (..., 3)."""
    r, t = np.asarray(rotation, np.float64), np.asarray(translation, np.float64)
    matrix = np.zeros((*np.broadcast_shapes(r.shape[:-2], t.shape[:-1]), 4, 4))
    matrix[..., :3, :3], matrix[..., :3, 3], matrix[..., 3, 3] = r, t, 1.0
    return matrix


def quaternion_to_rotation(quaternion_xyzw: ArrayLike) -> Array:
    """Rotation matrices (..., 3, 3) of quaternions (..., 4) as x, y, z, w; normalised first."""
    q = np.asarray(quaternion_xyzw, np.float64)
    x, y, z, w = np.moveaxis(q / np.linalg.norm(q, axis=-1, keepdims=True), -1, 0)
    rows = [
        [1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)],
        [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)],
        [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)],
    ]
    return np.stack([np.stack(row, axis=-1) for row in rows], axis=-2)


def rotation_to_quaternion(rotation: ArrayLike) -> Array:
    """Unit quaternions (..., 4) as x, y, z, w with w >= 0, of rotations (..., 3, 3).

    Bar-Itzhack's eigenvector method: the largest eigenvector of a symmetric 4x4 matrix, so that
    a slightly non-orthonormal matrix gives the nearest rotation.
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


def skew(vector: ArrayLike) -> Array:
    """The matrix (..., 3, 3) whose product with u is the cross product `vector x u`."""
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
    if (far := cosine < -0.5).any():  # towards pi the sine tells ever less of the axis
        vector[far] = _log_by_quaternion(r[far])
    return vector


def _log_by_quaternion(rotation: Array) -> Array:
    quaternion = rotation_to_quaternion(rotation)
    vector, scalar = quaternion[..., :3], quaternion[..., 3]
    length = np.linalg.norm(vector, axis=-1)
    return np.asarray(vector * (2.0 * np.arctan2(length, scalar) / length)[..., None])


def _so3_left_jacobian(rotation_vector: Array) -> Array:
    angle = np.linalg.norm(rotation_vector, axis=-1)[..., None, None]
    small = angle < 1e-5
    safe = np.where(small, 1.0, angle)
    k = skew(rotation_vector)
    first = np.where(small, 0.5, (1.0 - np.cos(safe)) / safe**2)
    second = np.where(small, 1.0 / 6.0, (safe - np.sin(safe)) / safe**3)
    return np.asarray(np.eye(3) + first * k + second * (k @ k))


def se3_exp(tangent: ArrayLike) -> Array:
    """Motions (..., 4, 4) of tangents (..., 6), rotation first."""
    t = np.asarray(tangent, np.float64)
    translation = np.einsum("...ij,...j->...i", _so3_left_jacobian(t[..., :3]), t[..., 3:])
    return make_transform(so3_exp(t[..., :3]), translation)


def se3_log(a_from_b: ArrayLike) -> Array:
    """Tangents (..., 6), rotation first, of motions (..., 4, 4)."""
    m = np.asarray(a_from_b, np.float64)
    rotation_vector = so3_log(m[..., :3, :3])
    # The inverse of `_so3_left_jacobian`, which turns the translation of `se3_exp` back.
    angle = np.linalg.norm(rotation_vector, axis=-1)[..., None]
    small = angle < 1e-3
    half = np.where(small, 1.0, 0.5 * angle)
    series = 1.0 / 12.0 + angle * angle / 720.0
    second = np.where(small, series, (1.0 - half / np.tan(half)) / (4.0 * half * half))
    k, shift = skew(rotation_vector), m[..., :3, 3, None]
    across = k @ shift
    translation = (shift - 0.5 * across)[..., 0] + second * (k @ across)[..., 0]
    return np.concatenate([rotation_vector, translation], axis=-1)


def se3_adjoint(a_from_b: ArrayLike) -> Array:
    """The adjoint (..., 6, 6): `a_from_b @ exp(t) == exp(adjoint @ t) @ a_from_b`."""
    m = np.asarray(a_from_b, np.float64)
    rotation = m[..., :3, :3]
    adjoint = np.zeros((*m.shape[:-2], 6, 6))
    adjoint[..., :3, :3] = adjoint[..., 3:, 3:] = rotation
    adjoint[..., 3:, :3] = skew(m[..., :3, 3]) @ rotation
    return adjoint


def rotation_angle(a_from_b: ArrayLike) -> Array:
    """The angle (...) in radians, 0 to pi, of motions (..., 4, 4) or rotations (..., 3, 3)."""
    r = np.asarray(a_from_b, np.float64)
    axis = [r[..., 2, 1] - r[..., 1, 2], r[..., 0, 2] - r[..., 2, 0], r[..., 1, 0] - r[..., 0, 1]]
    sine = 0.5 * np.sqrt(axis[0] ** 2 + axis[1] ** 2 + axis[2] ** 2)
    cosine = 0.5 * (r[..., 0, 0] + r[..., 1, 1] + r[..., 2, 2] - 1.0)
    return np.asarray(np.arctan2(sine, cosine))


def interpolate(map_from_a: ArrayLike, map_from_b: ArrayLike, fraction: ArrayLike) -> Array:
    """Poses (..., 4, 4) between a (fraction 0) and b (1): rotation by slerp, position straight."""
    a, b = np.asarray(map_from_a, np.float64), np.asarray(map_from_b, np.float64)
    f = np.asarray(fraction, np.float64)[..., None]
    turn = so3_log(np.swapaxes(a[..., :3, :3], -1, -2) @ b[..., :3, :3])
    rotation = a[..., :3, :3] @ so3_exp(f * turn)
    return make_transform(rotation, (1.0 - f) * a[..., :3, 3] + f * b[..., :3, 3])


def evenly_along(poses: Array, spacing: float) -> NDArray[np.int64]:
    """Indices of the first pose and of each that lies `spacing` m or rad of path farther on.

    `poses` (N, 4, 4) in the order of motion; a turn counts where it is larger than the way. All
    of them where `spacing` is 0.
    """
    if spacing <= 0.0 or len(poses) < 2:
        return np.arange(len(poses))
    steps = between(poses[:-1], poses[1:])
    moved = np.maximum(np.linalg.norm(steps[:, :3, 3], axis=1), rotation_angle(steps))
    lengths = np.concatenate([[0.0], np.cumsum(moved)]) / spacing + 1e-9
    return np.flatnonzero(np.diff(np.floor(lengths), prepend=-1.0))


def interpolate_planar(a: ArrayLike, b: ArrayLike, fraction: ArrayLike) -> Array:
    """Planar poses (..., 3) between a (fraction 0) and b (1), turning the shorter way."""
    a, b = np.asarray(a, np.float64), np.asarray(b, np.float64)
    f = np.asarray(fraction, np.float64)
    step = b - a
    yaw = wrap_angle(a[..., 2] + f * wrap_angle(step[..., 2]))
    position = a[..., :2] + f[..., None] * step[..., :2]
    return np.concatenate([position, yaw[..., None]], axis=-1)


def information_from_planar(information: ArrayLike, *, off_plane: float = 1e6) -> Array:
    """Information (..., 6, 6), rotation first, of one over x, y, yaw (..., 3, 3).

    Height, roll and pitch, which a planar measurement knows to be zero, get `off_plane`.
    """
    planar = np.asarray(information, np.float64)
    full = np.zeros((*planar.shape[:-2], 6, 6))
    full[..., [0, 1, 5], [0, 1, 5]] = off_plane
    full[..., PLANAR_IN_TANGENT[:, None], PLANAR_IN_TANGENT] = planar
    return full


def information_to_planar(information: ArrayLike) -> Array:
    """Information over x, y, yaw (..., 3, 3), given that height, roll and pitch are zero."""
    full = np.asarray(information, np.float64)
    return np.asarray(full[..., PLANAR_IN_TANGENT[:, None], PLANAR_IN_TANGENT])
