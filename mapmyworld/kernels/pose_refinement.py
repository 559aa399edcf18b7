"""The normal equations of a camera's pose from 3D points.

Poses are map_from_camera (4, 4). An observation is a row x, y, q: the point's normalised image
coordinates and its inverse depth, NaN without depth. A row of sigmas holds the standard
deviations of x and y, and of q, and the deviation of q beyond which it is an outlier.
"""

from __future__ import annotations

import numpy as np

from mapmyworld.geometry import Array
from mapmyworld.kernels.compiling import jit


@jit
def pose_normal_equations(
    pose: Array,
    points: Array,
    seen: Array,
    sigmas: Array,
    width: float,
    information: Array,
    gradient: Array,
) -> float:
    """Fills the normal equations (6, 6) and (6,) of a pose (4, 4) and gives the robust cost.

    It sees points (N, 3), map frame, as `seen`, with `sigmas`, (N, 3) both. Weights are Huber's
    with `width` in sigmas, for image position and depth apart.
    """
    information[:] = 0.0
    gradient[:] = 0.0
    cost = 0.0
    j = np.zeros((3, 6))
    residual = np.zeros(3)
    weights = np.zeros(3)
    for i in range(len(points)):
        dx, dy, dz = points[i, 0] - pose[0, 3], points[i, 1] - pose[1, 3], points[i, 2] - pose[2, 3]
        z = pose[0, 2] * dx + pose[1, 2] * dy + pose[2, 2] * dz
        if z < 1e-3:
            continue
        q = 1.0 / z
        x = (pose[0, 0] * dx + pose[1, 0] * dy + pose[2, 0] * dz) * q
        y = (pose[0, 1] * dx + pose[1, 1] * dy + pose[2, 1] * dz) * q
        # Rows of d(x, y, q) / d(tangent): under it the point moves by p x w - v.
        j[0, 0], j[0, 1], j[0, 2] = x * y, -(1.0 + x * x), y
        j[0, 3], j[0, 4], j[0, 5] = -q, 0.0, x * q
        j[1, 0], j[1, 1], j[1, 2] = 1.0 + y * y, -x * y, -x
        j[1, 3], j[1, 4], j[1, 5] = 0.0, -q, y * q
        j[2, 0], j[2, 1], j[2, 2] = y * q, -x * q, 0.0
        j[2, 3], j[2, 4], j[2, 5] = 0.0, 0.0, q * q
        residual[0], residual[1], residual[2] = x - seen[i, 0], y - seen[i, 1], 0.0
        weights[0] = 1.0 / (sigmas[i, 0] * sigmas[i, 0])
        weights[2] = 0.0
        r = np.sqrt((residual[0] * residual[0] + residual[1] * residual[1]) * weights[0])
        if r > width:
            weights[0] *= width / r
            cost += width * (2.0 * r - width)
        else:
            cost += r * r
        weights[1] = weights[0]
        if not np.isnan(seen[i, 2]):
            residual[2] = q - seen[i, 2]
            s = abs(residual[2]) / sigmas[i, 1]
            weights[2] = 1.0 / (sigmas[i, 1] * sigmas[i, 1])
            if s > width:
                weights[2] *= width / s
                cost += width * (2.0 * s - width)
            else:
                cost += s * s
        for k in range(3):
            for m in range(6):
                weighted = weights[k] * j[k, m]
                gradient[m] += weighted * residual[k]
                for n in range(m, 6):
                    information[m, n] += weighted * j[k, n]
    for m in range(6):
        for n in range(m):
            information[m, n] = information[n, m]
    return cost
