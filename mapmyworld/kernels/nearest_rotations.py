"""The rotations nearest to matrices: the quaternion that a symmetric matrix stretches most.

Horn, "Closed-form solution of absolute orientation using unit quaternions" (1987); eigenvectors by
Jacobi's rotations.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from mapmyworld.kernels.compiling import inner_jit, jit

Floats = NDArray[np.float64]

_SWEEPS = 20  # at most: each squares what is left beside the diagonal
_LEFT = 1e-31  # square of what may be left, against that of the whole


@inner_jit
def _diagonalise(matrix: Floats, vectors: Floats) -> None:
    """Makes a symmetric matrix diagonal; its eigenvectors are the columns of `vectors`."""
    size = len(matrix)
    for i in range(size):
        for j in range(size):
            vectors[i, j] = 1.0 if i == j else 0.0
    for _ in range(_SWEEPS):
        beside, whole = 0.0, 0.0
        for i in range(size):
            whole += matrix[i, i] ** 2
            for j in range(i):
                beside += matrix[i, j] ** 2
        if beside <= _LEFT * whole:
            return
        for p in range(size):
            for q in range(p + 1, size):
                if matrix[p, q] == 0.0:
                    continue
                ratio = 0.5 * (matrix[q, q] - matrix[p, p]) / matrix[p, q]
                tangent = math.copysign(1.0, ratio) / (abs(ratio) + math.sqrt(ratio**2 + 1.0))
                c = 1.0 / math.sqrt(tangent**2 + 1.0)
                s = tangent * c
                for k in range(size):
                    a, b = matrix[k, p], matrix[k, q]
                    matrix[k, p], matrix[k, q] = c * a - s * b, s * a + c * b
                for k in range(size):
                    a, b = matrix[p, k], matrix[q, k]
                    matrix[p, k], matrix[q, k] = c * a - s * b, s * a + c * b
                    a, b = vectors[k, p], vectors[k, q]
                    vectors[k, p], vectors[k, q] = c * a - s * b, s * a + c * b
                matrix[p, q] = matrix[q, p] = 0.0


@jit
def nearest_spatial(matrices: Floats, found: Floats) -> None:
    """Sets the rotations (N, 3, 3) that are nearest to matrices in the Frobenius norm."""
    form, vectors = np.empty((4, 4)), np.empty((4, 4))
    for n in range(len(matrices)):
        m = matrices[n]
        form[3, 3] = m[0, 0] + m[1, 1] + m[2, 2]
        for i in range(3):
            j, k = (i + 1) % 3, (i + 2) % 3
            form[i, i] = m[i, i] - m[j, j] - m[k, k]
            form[i, j] = form[j, i] = m[i, j] + m[j, i]
            form[i, 3] = form[3, i] = m[k, j] - m[j, k]
        _diagonalise(form, vectors)
        best = 0
        for i in range(1, 4):
            if form[i, i] > form[best, best]:
                best = i
        w = vectors[3, best]
        for i in range(3):
            j, k = (i + 1) % 3, (i + 2) % 3
            x, y, z = vectors[i, best], vectors[j, best], vectors[k, best]
            found[n, i, i] = 1.0 - 2.0 * (y * y + z * z)
            found[n, i, j], found[n, j, i] = 2.0 * (x * y - z * w), 2.0 * (x * y + z * w)
