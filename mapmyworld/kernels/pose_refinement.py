"""Inner loops of a camera's pose from 3D points: scoring hypotheses, normal equations.

Poses are map_from_camera (4, 4). An observation is a row x, y, q: the point's normalised image
coordinates and its inverse depth, NaN without depth. A row of sigmas holds the standard
deviations of x and y, and of q, and the deviation of q beyond which it is an outlier.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from mapmyworld.kernels.assignment import assign
from mapmyworld.kernels.compiling import inner_jit, jit

Array = NDArray[np.float64]
BEHIND = 1e12  # squared error of a point behind the camera


@jit
def squared_errors(pose: Array, points: Array, seen: Array, sigmas: Array, errors: Array) -> None:
    """Fills `errors` (N, 2), squared, in units of sigma: image position, inverse depth (0 without).

    Of points (N, 3), map frame, from map_from_camera (4, 4); `seen`, `sigmas` (N, 3).
    """
    for i in range(len(points)):
        dx, dy, dz = points[i, 0] - pose[0, 3], points[i, 1] - pose[1, 3], points[i, 2] - pose[2, 3]
        z = pose[0, 2] * dx + pose[1, 2] * dy + pose[2, 2] * dz
        if z < 1e-3:
            errors[i, 0] = errors[i, 1] = BEHIND
            continue
        x = (pose[0, 0] * dx + pose[1, 0] * dy + pose[2, 0] * dz) / z - seen[i, 0]
        y = (pose[0, 1] * dx + pose[1, 1] * dy + pose[2, 1] * dz) / z - seen[i, 1]
        errors[i, 0] = (x * x + y * y) / (sigmas[i, 0] * sigmas[i, 0])
        errors[i, 1] = 0.0
        if not np.isnan(seen[i, 2]):
            q = (1.0 / z - seen[i, 2]) / sigmas[i, 1]
            errors[i, 1] = q * q


@jit
def score_poses(
    poses: Array, points: Array, seen: Array, sigmas: Array, limit: float, counts: NDArray[np.int64]
) -> None:
    """Fills `counts` (K,): the observations that agree with each pose (K, 4, 4).

    They are within `limit` sigma, and their depth is no outlier; `points`, `seen`, `sigmas` (N, 3).
    """
    squared = limit * limit
    for k in range(len(poses)):
        counts[k] = 0
        for i in range(len(points)):
            dx = points[i, 0] - poses[k, 0, 3]
            dy = points[i, 1] - poses[k, 1, 3]
            dz = points[i, 2] - poses[k, 2, 3]
            z = poses[k, 0, 2] * dx + poses[k, 1, 2] * dy + poses[k, 2, 2] * dz
            if z < 1e-3:
                continue
            x = (poses[k, 0, 0] * dx + poses[k, 1, 0] * dy + poses[k, 2, 0] * dz) / z - seen[i, 0]
            y = (poses[k, 0, 1] * dx + poses[k, 1, 1] * dy + poses[k, 2, 1] * dz) / z - seen[i, 1]
            if x * x + y * y > squared * sigmas[i, 0] * sigmas[i, 0]:
                continue
            if not np.isnan(seen[i, 2]) and abs(1.0 / z - seen[i, 2]) > sigmas[i, 2]:
                continue
            counts[k] += 1


@inner_jit
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


@jit
def refine(
    pose: Array,
    points: Array,
    seen: Array,
    sigmas: Array,
    width: float,
    information: Array,
) -> None:
    """Gauss-Newton on a pose (4, 4) in place, and its information (6, 6) there.

    It sees points (N, 3), map frame, as `seen`, with `sigmas`, (N, 3) both. A step that does not
    lower the robust cost is taken back and ends it, as does one that lowers it by less than a
    ten-thousandth.
    """
    trial, equations, gradient, tangent = pose.copy(), np.zeros((6, 6)), np.zeros(6), np.zeros(6)
    best = np.inf
    while True:
        cost = pose_normal_equations(trial, points, seen, sigmas, width, equations, gradient)
        if not cost < best:
            return
        assign(pose, trial)
        assign(information, equations)
        if best - cost < 1e-4 * cost:
            return
        best = cost
        solve_damped(equations, gradient, tangent)
        move_by_tangent(trial, tangent)


@jit
def solve_damped(matrix: Array, right: Array, found: Array) -> None:
    """Fills `found` (6,), which a symmetric matrix (6, 6), a little damped, takes to -right (6,).

    By Cholesky's factors.
    """
    n = len(right)
    lower = np.zeros((n, n))
    for i in range(n):
        for j in range(i + 1):
            total = matrix[i, j]
            for k in range(j):
                total -= lower[i, k] * lower[j, k]
            if i == j:
                lower[i, i] = np.sqrt(max(total + 1e-6 * matrix[i, i] + 1e-9, 1e-12))
            else:
                lower[i, j] = total / lower[j, j]
    for i in range(n):
        total = -right[i]
        for k in range(i):
            total -= lower[i, k] * found[k]
        found[i] = total / lower[i, i]
    for i in range(n - 1, -1, -1):
        total = found[i]
        for k in range(i + 1, n):
            total -= lower[k, i] * found[k]
        found[i] = total / lower[i, i]


@jit
def move_by_tangent(pose: Array, tangent: Array) -> None:
    """`pose @ se3_exp(tangent)` (4, 4) in place; the tangent (6,) has its rotation first."""
    x, y, z = tangent[0], tangent[1], tangent[2]
    squared = x * x + y * y + z * z
    if squared < 1e-16:
        first, second, third = 1.0, 0.5, 1.0 / 6.0
    else:
        angle = np.sqrt(squared)
        first, second = np.sin(angle) / angle, (1.0 - np.cos(angle)) / squared
        third = (1.0 - first) / squared
        if angle < 1e-4:
            second, third = 0.5, 1.0 / 6.0
    turn, shift = np.zeros((3, 3)), np.zeros((3, 3))  # first what is skew of them
    turn[0, 1], turn[0, 2], turn[1, 2] = -z, y, -x
    turn[1, 0], turn[2, 0], turn[2, 1] = z, -y, x
    for i in range(3):
        for j in range(3):
            square = tangent[i] * tangent[j] - (squared if i == j else 0.0)
            shift[i, j] = second * turn[i, j] + third * square
            turn[i, j] = first * turn[i, j] + second * square
        turn[i, i] += 1.0
        shift[i, i] += 1.0
    moved = np.zeros((3, 4))
    for i in range(3):
        for j in range(3):
            moved[i, j] = (
                pose[i, 0] * turn[0, j] + pose[i, 1] * turn[1, j] + pose[i, 2] * turn[2, j]
            )
        moved[i, 3] = pose[i, 3]
        for j in range(3):
            step = shift[j, 0] * tangent[3] + shift[j, 1] * tangent[4] + shift[j, 2] * tangent[5]
            moved[i, 3] += pose[i, j] * step
    assign(pose, moved)
