"""Numbers of graph files as poses and matrices: triangles, quaternions, angles, covariances."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from mapmyworld.geometry import Array
from mapmyworld.geometry.rigid import SWAP_ROTATION_TRANSLATION, make_transform
from mapmyworld.geometry.rotations import quaternion_to_rotation, so3_exp

LEAST_VARIANCE = 1e-30  # m^2 or rad^2
TRIANGLE = {size: np.triu_indices(size) for size in (2, 3, 6)}
# TORO's order of the six entries of a planar information: ff, fs, ss, rr, fr, sr.
ORDER: dict[str, list[int] | slice] = {"EDGE2": [0, 1, 4, 2, 5, 3]}


def symmetric(entries: Array, order: list[int] | slice) -> Array:
    """Matrices (R, d, d) of upper triangles (R, d (d + 1) / 2)."""
    values = entries[:, order]
    size = {3: 2, 6: 3, 21: 6}[values.shape[1]]
    rows, columns = TRIANGLE[size]
    matrices = np.zeros((len(values), size, size))
    matrices[:, rows, columns] = values
    matrices[:, columns, rows] = values
    return matrices


def inverted(covariances: Array) -> Array:
    """Information matrices; zeros, which no edge may have, of what is no covariance."""
    lowest = np.linalg.eigvalsh(covariances)[:, 0]
    good = lowest > 1e-14 * np.abs(covariances).max(axis=(1, 2), initial=LEAST_VARIANCE)
    found = np.zeros(covariances.shape)
    found[good] = np.linalg.inv(covariances[good])
    return found


def rotation_first(information: Array) -> Array:
    """Information matrices (R, 6, 6) of files that put the translation first."""
    return information[:, SWAP_ROTATION_TRANSLATION[:, None], SWAP_ROTATION_TRANSLATION]


def _planar(numbers: Array) -> Array:
    return numbers[..., :3].copy()


def from_quaternions(numbers: Array) -> Array:
    """Poses (R, 4, 4) of x, y, z and a quaternion x y z w (R, 7)."""
    return make_transform(quaternion_to_rotation(numbers[..., 3:7]), numbers[..., :3])


def _from_angles(numbers: Array) -> Array:
    """Poses of x, y, z, roll, pitch, yaw (R, 6)."""
    roll, pitch, yaw = (so3_exp(numbers[:, 3 + k, None] * np.eye(3)[k]) for k in range(3))
    return make_transform(yaw @ pitch @ roll, numbers[:, :3])


POSES: dict[str, Callable[[Array], Array]] = {
    "VERTEX_SE2": _planar,
    "VERTEX2": _planar,
    "EDGE_SE2": _planar,
    "EDGE2": _planar,
    "ODOMETRY": _planar,
    "VERTEX_SE3:QUAT": from_quaternions,
    "EDGE_SE3:QUAT": from_quaternions,
    "VERTEX3": _from_angles,
    "EDGE3": _from_angles,
}
