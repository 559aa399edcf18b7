"""Poses moved by tangents in their own frames: what every step of the optimiser does.

The exponential maps are those of Sola, Deray, Atchuthan, "A micro Lie theory" (2018).
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from mapmyworld.kernels.compiling import jit

Floats = NDArray[np.float64]


@jit
def planar_moved(poses: Floats, tangents: Floats, found: Floats) -> None:
    """Sets (N, 3) to `pose * exp(tangent)` of poses and tangents (N, 3) over x, y, yaw."""
    for n in range(len(poses)):
        x, y, yaw = tangents[n, 0], tangents[n, 1], tangents[n, 2]
        along, across = 1.0 - yaw * yaw / 6.0, 0.5 * yaw
        if abs(yaw) > 1e-5:
            along, across = math.sin(yaw) / yaw, (1.0 - math.cos(yaw)) / yaw
        x, y = along * x - across * y, across * x + along * y
        c, s = math.cos(poses[n, 2]), math.sin(poses[n, 2])
        found[n, 0] = poses[n, 0] + c * x - s * y
        found[n, 1] = poses[n, 1] + s * x + c * y
        turn = poses[n, 2] + yaw
        found[n, 2] = math.pi - (math.pi - turn) % (2.0 * math.pi)


@jit
def spatial_moved(poses: Floats, tangents: Floats, found: Floats) -> None:
    """Adds `pose * exp(tangent)` of poses and tangents (N, 6), rotation first, to (N, 4, 4)."""
    move = np.empty((3, 4))
    for n in range(len(poses)):
        square = tangents[n, 0] ** 2 + tangents[n, 1] ** 2 + tangents[n, 2] ** 2
        first, second, third = 1.0 - square / 6.0, 0.5 - square / 24.0, 1.0 / 6.0 - square / 120.0
        if square > 1e-8:
            angle = math.sqrt(square)
            first, second = math.sin(angle) / angle, (1.0 - math.cos(angle)) / square
            third = (1.0 - first) / square
        for i in range(3):  # exp = [I + a W + b W^2, (I + b W + c W^2) u], W^2 = w w' - w'w I
            j, k = (i + 1) % 3, (i + 2) % 3
            w, v, z = tangents[n, i], tangents[n, j], tangents[n, k]
            move[i, i] = 1.0 - second * (v * v + z * z)
            move[i, j], move[i, k] = second * w * v - first * z, second * w * z + first * v
            u, p, q = tangents[n, 3 + i], tangents[n, 3 + j], tangents[n, 3 + k]
            along = w * u + v * p + z * q
            move[i, 3] = (1.0 - third * square) * u + third * along * w + second * (v * q - z * p)
        for i in range(3):
            for j in range(4):
                for k in range(3):
                    found[n, i, j] += poses[n, i, k] * move[k, j]
            found[n, i, 3] += poses[n, i, 3]
        found[n, 3, 3] = 1.0
