"""Numbers of graph files as poses and matrices: triangles, quaternions, angles, covariances."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from mapmyworld.geometry import Array
from mapmyworld.geometry.rigid import SWAP_ROTATION_TRANSLATION, make_transform
from mapmyworld.geometry.rotations import quaternion_to_rotation, so3_exp

Index = NDArray[np.int64]

LEAST_VARIANCE = 1e-30  # m^2 or rad^2


def _layout(size: int) -> Index:
    layout = np.zeros((size, size), np.int64)
    rows, columns = np.triu_indices(size)
    layout[rows, columns] = layout[columns, rows] = np.arange(len(rows))
    return layout


ROW_BY_ROW = {size: _layout(size) for size in (2, 3, 6)}
"""Size d -> where in an upper triangle each entry (d, d) of its matrix stands."""
# TORO's order of the six entries of a planar information: ff, fs, ss, rr, fr, sr.
TORO = np.array([0, 1, 4, 2, 5, 3])[ROW_BY_ROW[3]]
# For a matrix (6, 6) with rotation first, of files that put the translation first.
ROTATION_FIRST = ROW_BY_ROW[6][SWAP_ROTATION_TRANSLATION[:, None], SWAP_ROTATION_TRANSLATION]


def symmetric(numbers: Array, layout: Index) -> Array:
    """Matrices (R, d, d) by `layout` (d, d) of the upper triangles at the ends of rows (R, ...)."""
    size = len(layout)
    return numbers[:, -(size * (size + 1) // 2) :].take(layout, axis=1)


def inverted(covariances: Array) -> Array:
    """Information matrices of covariances, (N, d, d) both.

    Zeros, which no edge may have, of what is no covariance.
    """
    lowest = np.linalg.eigvalsh(covariances)[:, 0]
    good = lowest > 1e-14 * np.abs(covariances).max(axis=(1, 2), initial=LEAST_VARIANCE)
    found = np.zeros(covariances.shape)
    found[good] = np.linalg.inv(covariances[good])
    return found


def _as_they_are(numbers: Array) -> Array:
    """X, y, yaw, or a point."""
    return numbers[..., :3].copy()


def from_quaternions(numbers: Array) -> Array:
    """Poses (..., 4, 4) of x, y, z and a quaternion x y z w (..., 7)."""
    return make_transform(quaternion_to_rotation(numbers[..., 3:7]), numbers[..., :3])


def _from_angles(numbers: Array) -> Array:
    """Poses of x, y, z, roll, pitch, yaw (R, 6)."""
    roll, pitch, yaw = (so3_exp(numbers[:, 3 + k, None] * np.eye(3)[k]) for k in range(3))
    return make_transform(yaw @ pitch @ roll, numbers[:, :3])


POSES: dict[str, Callable[[Array], Array]] = {
    "VERTEX_SE2": _as_they_are,
    "VERTEX2": _as_they_are,
    "EDGE_SE2": _as_they_are,
    "EDGE2": _as_they_are,
    "ODOMETRY": _as_they_are,
    "VERTEX_SE3:QUAT": from_quaternions,
    "EDGE_SE3:QUAT": from_quaternions,
    "VERTEX3": _from_angles,
    "VERTEX_XY": _as_they_are,
    "VERTEX_TRACKXYZ": _as_they_are,
    "EDGE3": _from_angles,
}
