"""SE(3): rigid motions as matrices (..., 4, 4).

Tangents are ordered rotation, then translation, and perturb on the right:
`pose @ se3_exp(tangent)` (gtsam's convention).
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from mapmyworld.geometry import Array
from mapmyworld.geometry.rotations import rotation_angle, skew, so3_exp, so3_log

# Takes a translation-first tangent (g2o, RTAB-Map) to a rotation-first one, and back.
SWAP_ROTATION_TRANSLATION = np.array([3, 4, 5, 0, 1, 2])


def make_transform(rotation: ArrayLike, translation: ArrayLike) -> Array:
    """The matrix (..., 4, 4) of a rotation (..., 3, 3) and a translation (..., 3)."""
    r, t = np.asarray(rotation, np.float64), np.asarray(translation, np.float64)
    same = r.shape[:-2] == t.shape[:-1]  # numpy takes long to find out
    shape = t.shape[:-1] if same else np.broadcast_shapes(r.shape[:-2], t.shape[:-1])
    matrix = np.zeros((*shape, 4, 4))
    matrix[..., :3, :3], matrix[..., :3, 3], matrix[..., 3, 3] = r, t, 1.0
    return matrix


def transforms_of_rows(rows: ArrayLike) -> Array:
    """Matrices (N, 4, 4) of their upper `rows` (N, 3, 4), in any shape that holds these."""
    matrices = np.zeros((np.size(rows) // 12, 4, 4))
    matrices[:, :3], matrices[:, 3, 3] = np.reshape(rows, (-1, 3, 4)), 1.0
    return matrices


def invert(a_from_b: ArrayLike) -> Array:
    """`b_from_a` (..., 4, 4) of `a_from_b` (..., 4, 4), by the transpose of the rotation."""
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
    """`a_from_b` (..., 4, 4) of two poses (..., 4, 4)."""
    return np.asarray(invert(map_from_a) @ np.asarray(map_from_b, np.float64))


def transform_points(a_from_b: ArrayLike, points: ArrayLike) -> Array:
    """Points of frame b, expressed in frame a, (..., N, 3) both, by `a_from_b` (..., 4, 4)."""
    m, p = np.asarray(a_from_b, np.float64), np.asarray(points, np.float64)
    return np.asarray(p @ np.swapaxes(m[..., :3, :3], -1, -2) + m[..., None, :3, 3])


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
    """The adjoint (..., 6, 6), rotation first, of a motion (..., 4, 4).

    `a_from_b @ exp(t) == exp(adjoint @ t) @ a_from_b`.
    """
    m = np.asarray(a_from_b, np.float64)
    rotation = m[..., :3, :3]
    adjoint = np.zeros((*m.shape[:-2], 6, 6))
    adjoint[..., :3, :3] = adjoint[..., 3:, 3:] = rotation
    adjoint[..., 3:, :3] = skew(m[..., :3, 3]) @ rotation
    return adjoint


def transported(adjoint: Array, covariances: NDArray[np.floating]) -> Array:
    """Tangents' `covariances` (N, d, d) in frames that `adjoint` (N, d, d) leads to: (N, d, d)."""
    return np.asarray(adjoint @ covariances @ np.swapaxes(adjoint, 1, 2), np.float64)


def interpolate(map_from_a: ArrayLike, map_from_b: ArrayLike, fraction: ArrayLike) -> Array:
    """Poses (..., 4, 4) at a `fraction` (...) of the way between two poses (..., 4, 4).

    It is 0 at a and 1 at b: the rotation by slerp (Shoemake, "Animating rotation with quaternion
    curves", 1985), the position straight.
    """
    a, b = np.asarray(map_from_a, np.float64), np.asarray(map_from_b, np.float64)
    f = np.asarray(fraction, np.float64)[..., None]
    turn = so3_log(np.swapaxes(a[..., :3, :3], -1, -2) @ b[..., :3, :3])
    rotation = a[..., :3, :3] @ so3_exp(f * turn)
    return make_transform(rotation, (1.0 - f) * a[..., :3, 3] + f * b[..., :3, 3])


def evenly_along(poses: Array, spacing: float) -> NDArray[np.int64]:
    """Indices (K,) of the first pose and of each that lies `spacing` m or rad of path farther on.

    `poses` (N, 4, 4) in the order of motion; a turn counts where it is larger than the way. All
    of them where `spacing` is 0.
    """
    if spacing <= 0.0 or len(poses) < 2:
        return np.arange(len(poses))
    steps = between(poses[:-1], poses[1:])
    moved = np.maximum(np.linalg.norm(steps[:, :3, 3], axis=1), rotation_angle(steps))
    lengths = np.concatenate([[0.0], np.cumsum(moved)]) / spacing + 1e-9
    return np.flatnonzero(np.diff(np.floor(lengths), prepend=-1.0))
