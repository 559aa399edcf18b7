"""Poses of the plane and matrices of three rows, for kernels: numpy costs twenty times more."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from mapmyworld.kernels.compiling import inner_jit, jit


@jit
def solve3(a: NDArray[np.float64], b: NDArray[np.float64]) -> NDArray[np.float64]:
    """The solution (3,) of a system `a` (3, 3), symmetric and positive definite, and `b` (3,).

    By Cholesky's factors.
    """
    l00 = np.sqrt(a[0, 0])
    l10, l20 = a[1, 0] / l00, a[2, 0] / l00
    l11 = np.sqrt(max(a[1, 1] - l10 * l10, 1e-18))
    l21 = (a[2, 1] - l20 * l10) / l11
    l22 = np.sqrt(max(a[2, 2] - l20 * l20 - l21 * l21, 1e-18))
    y0 = b[0] / l00
    y1 = (b[1] - l10 * y0) / l11
    y2 = (b[2] - l20 * y0 - l21 * y1) / l22
    x2 = y2 / l22
    x1 = (y1 - l21 * x2) / l11
    x0 = (y0 - l10 * x1 - l20 * x2) / l00
    return np.array([x0, x1, x2])


@jit
def invert3(a: NDArray[np.float64]) -> NDArray[np.float64]:
    """The inverse of an invertible matrix, (3, 3) both, by cofactors."""
    result = np.empty((3, 3))
    for i in range(3):
        for j in range(3):
            p, q, r, s = (j + 1) % 3, (j + 2) % 3, (i + 1) % 3, (i + 2) % 3
            result[i, j] = a[p, r] * a[q, s] - a[p, s] * a[q, r]
    determinant = a[0, 0] * result[0, 0] + a[0, 1] * result[1, 0] + a[0, 2] * result[2, 0]
    for i in range(3):
        for j in range(3):
            result[i, j] /= determinant
    return result


@jit
def relative(a: NDArray[np.float64], b: NDArray[np.float64]) -> NDArray[np.float64]:
    """`a_from_b` (3,) of two poses (3,) of the plane."""
    c, s = np.cos(a[2]), np.sin(a[2])
    dx, dy = b[0] - a[0], b[1] - a[1]
    return np.array([c * dx + s * dy, c * dy - s * dx, b[2] - a[2]])


@inner_jit
def adjoint_of_inverse(pose: NDArray[np.float64], adjoint: NDArray[np.float64]) -> None:
    """Fills the adjoint (3, 3) of the inverse of a pose (3,) of the plane."""
    c, s = np.cos(pose[2]), np.sin(pose[2])
    adjoint[0, 0], adjoint[0, 1], adjoint[1, 0], adjoint[1, 1] = c, s, -s, c
    adjoint[0, 2] = -(c * pose[1] - s * pose[0])
    adjoint[1, 2] = c * pose[0] + s * pose[1]
    adjoint[2, 0], adjoint[2, 1], adjoint[2, 2] = 0.0, 0.0, 1.0
