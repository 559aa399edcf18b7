"""SE(2): planar motions as rows `x, y, yaw` (..., 3), and what they are among those of space."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import ArrayLike

from mapmyworld.geometry import Array

# Rows of a rotation-first SE(3) tangent that a planar motion uses, in the order x, y, yaw.
PLANAR_IN_TANGENT = np.array([3, 4, 2])


def wrap_angle(angle: ArrayLike) -> Array:
    """Angles (...) in rad, wrapped into (-pi, pi], in the same shape."""
    angle = np.asarray(angle, dtype=np.float64)
    return np.asarray(np.pi - np.mod(np.pi - angle, 2.0 * np.pi))


def _wrap_one(angle: float) -> float:
    return math.pi - (math.pi - angle) % (2.0 * math.pi)


def _compose_one(ax: float, ay: float, ayaw: float, bx: float, by: float, byaw: float) -> Array:
    """One pair of planar motions, ten times as fast as arrays of one."""
    c, s = math.cos(ayaw), math.sin(ayaw)
    return np.array([ax + c * bx - s * by, ay + s * bx + c * by, _wrap_one(ayaw + byaw)])


def _columns(*parts: Array) -> Array:
    """Arrays (...), C of them, as (..., C): what `np.stack` does, at half its cost for a few."""
    found = np.empty((*parts[0].shape, len(parts)))
    for column, part in enumerate(parts):
        found[..., column] = part
    return found


def compose_planar(a_from_b: ArrayLike, b_from_c: ArrayLike) -> Array:
    """`a_from_c` (..., 3) of two motions (..., 3) of the plane."""
    a, b = np.asarray(a_from_b, np.float64), np.asarray(b_from_c, np.float64)
    if a.ndim == b.ndim == 1:
        return _compose_one(*a.tolist(), *b.tolist())
    cos, sin = np.cos(a[..., 2]), np.sin(a[..., 2])
    return _columns(
        a[..., 0] + cos * b[..., 0] - sin * b[..., 1],
        a[..., 1] + sin * b[..., 0] + cos * b[..., 1],
        wrap_angle(a[..., 2] + b[..., 2]),
    )


def invert_planar(a_from_b: ArrayLike) -> Array:
    """`b_from_a` (..., 3) of a planar motion (..., 3)."""
    a = np.asarray(a_from_b, np.float64)
    if a.ndim == 1:
        x, y, yaw = a.tolist()
        c, s = math.cos(yaw), math.sin(yaw)
        return np.array([-c * x - s * y, s * x - c * y, _wrap_one(-yaw)])
    cos, sin = np.cos(a[..., 2]), np.sin(a[..., 2])
    return _columns(
        -cos * a[..., 0] - sin * a[..., 1],
        sin * a[..., 0] - cos * a[..., 1],
        wrap_angle(-a[..., 2]),
    )


def between_planar(map_from_a: ArrayLike, map_from_b: ArrayLike) -> Array:
    """`a_from_b` (..., 3) of two poses (..., 3) of the plane."""
    return compose_planar(invert_planar(map_from_a), map_from_b)


def transform_points_planar(a_from_b: ArrayLike, points: ArrayLike) -> Array:
    """Points of frame b, expressed in frame a, (..., N, 2) both, by `a_from_b` (..., 3)."""
    a, p = np.asarray(a_from_b, np.float64), np.asarray(points, np.float64)
    cos, sin = np.cos(a[..., 2, None]), np.sin(a[..., 2, None])
    return _columns(
        a[..., 0, None] + cos * p[..., 0] - sin * p[..., 1],
        a[..., 1, None] + sin * p[..., 0] + cos * p[..., 1],
    )


def planar_adjoint(a_from_b: Array) -> Array:
    """The adjoint (..., 3, 3), over x, y, yaw, of a motion (..., 3) of the plane.

    `a_from_b exp(t) == exp(adjoint @ t) a_from_b`.
    """
    cos, sin = np.cos(a_from_b[..., 2]), np.sin(a_from_b[..., 2])
    matrix = np.zeros((*a_from_b.shape, 3))
    matrix[..., 0, 0], matrix[..., 0, 1], matrix[..., 0, 2] = cos, -sin, a_from_b[..., 1]
    matrix[..., 1, 0], matrix[..., 1, 1], matrix[..., 1, 2] = sin, cos, -a_from_b[..., 0]
    matrix[..., 2, 2] = 1.0
    return matrix


def interpolate_planar(a: ArrayLike, b: ArrayLike, fraction: ArrayLike) -> Array:
    """Poses (..., 3) at a `fraction` (...) of the way between two poses (..., 3) of the plane.

    It is 0 at `a` and 1 at `b`; the shorter way is turned.
    """
    a, b = np.asarray(a, np.float64), np.asarray(b, np.float64)
    f = np.asarray(fraction, np.float64)
    step = b - a
    yaw = wrap_angle(a[..., 2] + f * wrap_angle(step[..., 2]))
    position = a[..., :2] + f[..., None] * step[..., :2]
    return np.concatenate([position, yaw[..., None]], axis=-1)


def planar_log(motion: Array) -> Array:
    """Tangents (..., 3) of planar motions (..., 3): the constant twist that yields them."""
    yaw = motion[..., 2]
    half = 0.5 * yaw
    small = np.abs(yaw) < 1e-5
    safe = np.where(small, 1.0, half)
    factor = np.where(small, 1.0 - half * half / 3.0, safe / np.tan(safe))
    x, y = motion[..., 0], motion[..., 1]
    return _columns(factor * x + half * y, factor * y - half * x, yaw)


def planar_exp(tangent: Array) -> Array:
    """Planar motions (..., 3) of tangents (..., 3)."""
    yaw = tangent[..., 2]
    small = np.abs(yaw) < 1e-5
    safe = np.where(small, 1.0, yaw)
    along = np.where(small, 1.0 - yaw * yaw / 6.0, np.sin(safe) / safe)
    across = np.where(small, 0.5 * yaw, (1.0 - np.cos(safe)) / safe)
    x, y = tangent[..., 0], tangent[..., 1]
    return _columns(along * x - across * y, across * x + along * y, yaw)


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
    """`x, y, yaw` (..., 3) of SE(3) matrices (..., 4, 4); height, roll and pitch are dropped."""
    m = np.asarray(a_from_b, np.float64)
    yaw = np.arctan2(m[..., 1, 0], m[..., 0, 0])
    return _columns(m[..., 0, 3], m[..., 1, 3], yaw)


def information_from_planar(information: ArrayLike) -> Array:
    """Information (..., 6, 6), rotation first, of one over x, y, yaw (..., 3, 3).

    Height, roll and pitch, which a planar measurement knows to be zero, get a million.
    """
    return covariance_from_planar(information, off_plane=1e6)


def covariance_from_planar(covariance: ArrayLike, *, off_plane: float = 0.0) -> Array:
    """Covariance (..., 6, 6), rotation first, of one over x, y, yaw (..., 3, 3).

    Height, roll and pitch, which a planar pose has exactly, get the variance `off_plane`.
    """
    planar = np.asarray(covariance, np.float64)
    full = np.zeros((*planar.shape[:-2], 6, 6))
    full[..., [0, 1, 5], [0, 1, 5]] = off_plane
    full[..., PLANAR_IN_TANGENT[:, None], PLANAR_IN_TANGENT] = planar
    return full


def information_to_planar(information: ArrayLike) -> Array:
    """Information over x, y, yaw (..., 3, 3) of (..., 6, 6): height, roll and pitch are zero."""
    full = np.asarray(information, np.float64)
    return np.asarray(full[..., PLANAR_IN_TANGENT[:, None], PLANAR_IN_TANGENT])
