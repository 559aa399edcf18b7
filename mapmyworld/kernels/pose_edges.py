"""Errors of motions measured between poses, and their derivatives by right perturbations.

Tangents of the plane are x, y, yaw; of space rotation first. The formulas are those of Sola,
Deray, Atchuthan, "A micro Lie theory" (2018). Edges (E,) name the poses of their tails and heads.
Results are filled in: handing over an array that a kernel has made takes numba as long as a small
graph's residuals.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from mapmyworld.kernels.compiling import inner_jit, jit

Floats = NDArray[np.float64]
Index = NDArray[np.int64]


@inner_jit
def _square(information: Floats, residual: Floats) -> float:
    """The squared sigmas of an edge."""
    total = 0.0
    for i in range(len(residual)):
        pull = 0.0
        for j in range(len(residual)):
            pull += information[i, j] * residual[j]
        total += residual[i] * pull
    return total


@jit
def planar_residuals(
    poses: Floats,
    tails: Index,
    heads: Index,
    measured: Floats,
    information: Floats,
    found: Floats,
    squares: Floats,
) -> None:
    """Sets (E, 3) to `log(measured^-1 * tail^-1 * head)` of poses (N, 3), and their squares (E,).

    Squares are of those edges alone whose information is given.
    """
    for e in range(len(tails)):
        tail, head = poses[tails[e]], poses[heads[e]]
        angle, turn = tail[2], measured[e, 2]
        c, s = math.cos(angle), math.sin(angle)
        dx, dy = head[0] - tail[0], head[1] - tail[1]
        x, y = c * dx + s * dy - measured[e, 0], c * dy - s * dx - measured[e, 1]
        c, s = math.cos(turn), math.sin(turn)
        x, y = c * x + s * y, c * y - s * x
        yaw = head[2] - angle - turn
        yaw = math.pi - (math.pi - yaw) % (2.0 * math.pi)
        half = 0.5 * yaw
        factor = half / math.tan(half) if abs(yaw) > 1e-5 else 1.0 - half * half / 3.0
        found[e, 0], found[e, 1], found[e, 2] = factor * x + half * y, factor * y - half * x, yaw
        if e < len(information):
            squares[e] = _square(information[e], found[e])


@jit
def planar_jacobians(
    poses: Floats,
    tails: Index,
    heads: Index,
    residuals: Floats,
    by_tail: Floats,
    by_head: Floats,
) -> None:
    """Derivatives (E, 3, 3) of residuals (E, 3) by tangents of the tail and of the head.

    They are filled into zeros. Of the inverse right Jacobian of the exponential map only the
    column of the angle is not that of a rotation and a scale.
    """
    for e in range(len(tails)):
        tail, head = poses[tails[e]], poses[heads[e]]
        x, y, yaw = residuals[e, 0], residuals[e, 1], residuals[e, 2]
        half, square = 0.5 * yaw, yaw * yaw
        if abs(yaw) > 1e-2:
            second = 1.0 / square - 0.5 / (yaw * math.tan(half))
        else:
            second = 1.0 / 12.0 + square / 720.0
        first = 1.0 - second * square
        across, along = second * yaw * x, second * yaw * y
        head_x, head_y = across + 0.5 * y, along - 0.5 * x
        by_head[e, 0, 0] = by_head[e, 1, 1] = first
        by_head[e, 0, 1], by_head[e, 1, 0] = -half, half
        by_head[e, 0, 2], by_head[e, 1, 2], by_head[e, 2, 2] = head_x, head_y, 1.0
        turn = tail[2] - head[2]
        c, s = math.cos(turn), math.sin(turn)
        a, b = math.cos(head[2]), math.sin(head[2])
        dx, dy = tail[0] - head[0], tail[1] - head[1]
        px, py = a * dx + b * dy, a * dy - b * dx
        for row in range(3):
            u, v, w = by_head[e, row, 0], by_head[e, row, 1], by_head[e, row, 2]
            by_tail[e, row, 0] = -(u * c + v * s)
            by_tail[e, row, 1] = u * s - v * c
            by_tail[e, row, 2] = v * px - u * py - w


@inner_jit
def _vector_of(r: Floats, w: Floats) -> None:
    """The rotation vector w of a rotation r, also near half a turn."""
    for i in range(3):
        j, k = (i + 1) % 3, (i + 2) % 3
        w[i] = 0.5 * (r[k, j] - r[j, k])
    length = math.sqrt(w[0] ** 2 + w[1] ** 2 + w[2] ** 2)
    trace = r[0, 0] + r[1, 1] + r[2, 2]
    angle = math.atan2(length, 0.5 * (trace - 1.0))
    if trace < 0.0:  # towards half a turn the sine tells ever less of the axis: by the quaternion
        i = 0
        for j in range(1, 3):
            if r[j, j] > r[i, i]:
                i = j
        j, k = (i + 1) % 3, (i + 2) % 3
        double = math.sqrt(1.0 + r[i, i] - r[j, j] - r[k, k])
        double = double if w[i] >= 0.0 else -double
        scalar = w[i] / double
        w[i] = 0.5 * double
        w[j], w[k] = 0.5 * (r[i, j] + r[j, i]) / double, 0.5 * (r[i, k] + r[k, i]) / double
        length = math.sqrt(w[0] ** 2 + w[1] ** 2 + w[2] ** 2)
        angle = 2.0 * math.atan2(length, scalar)
    if length > 1e-8:
        for i in range(3):
            w[i] *= angle / length


@inner_jit
def _add_seen(viewer: Floats, seen: Floats, turn: Floats, shift: Floats) -> None:
    """Sets the seen pose's rotation in the viewer's frame, and adds its position to the shift."""
    for i in range(3):
        for k in range(3):
            shift[i] += viewer[k, i] * (seen[k, 3] - viewer[k, 3])
        for j in range(3):
            turn[i, j] = 0.0
            for k in range(3):
                turn[i, j] += viewer[k, i] * seen[k, j]


@jit
def spatial_residuals(
    poses: Floats,
    tails: Index,
    heads: Index,
    measured: Floats,
    information: Floats,
    found: Floats,
    squares: Floats,
) -> None:
    """Sets (E, 6) to `log(measured^-1 * tail^-1 * head)` of poses (N, 4, 4), and squares (E,).

    Squares are of those edges alone whose information is given.
    """
    turn, error = np.empty((3, 3)), np.empty((3, 3))
    shift, w, u = np.empty(3), np.empty(3), np.empty(3)
    for e in range(len(tails)):
        for i in range(3):
            shift[i] = -measured[e, i, 3]
        _add_seen(poses[tails[e]], poses[heads[e]], turn, shift)
        for i in range(3):
            u[i] = 0.0
            for k in range(3):
                u[i] += measured[e, k, i] * shift[k]
            for j in range(3):
                error[i, j] = 0.0
                for k in range(3):
                    error[i, j] += measured[e, k, i] * turn[k, j]
        _vector_of(error, w)
        square = w[0] ** 2 + w[1] ** 2 + w[2] ** 2
        second = 1.0 / 12.0 + square / 720.0
        if square > 1e-6:
            half = 0.5 * math.sqrt(square)
            second = (1.0 - half / math.tan(half)) / square
        for i in range(3):  # shift = w x u
            j, k = (i + 1) % 3, (i + 2) % 3
            shift[i] = w[j] * u[k] - w[k] * u[j]
        for i in range(3):
            j, k = (i + 1) % 3, (i + 2) % 3
            found[e, i] = w[i]
            found[e, 3 + i] = u[i] - 0.5 * shift[i] + second * (w[j] * shift[k] - w[k] * shift[j])
        if e < len(information):
            squares[e] = _square(information[e], found[e])


@jit
def spatial_jacobians(
    poses: Floats,
    tails: Index,
    heads: Index,
    residuals: Floats,
    by_tail: Floats,
    by_head: Floats,
) -> None:
    """Derivatives (E, 6, 6) of residuals (E, 6) by tangents of the tail and of the head.

    They are filled into zeros. The inverse right Jacobian [A 0; B A] is `A = I + W / 2 + c W^2`
    with c a function of the angle's square, and B is how A changes with the rotation along the
    translation.
    """
    turn, shift, mixed = np.empty((3, 3)), np.empty(3), np.empty((3, 3))
    for e in range(len(tails)):
        w, u = residuals[e, :3], residuals[e, 3:]
        s = w[0] ** 2 + w[1] ** 2 + w[2] ** 2
        along = w[0] * u[0] + w[1] * u[1] + w[2] * u[2]
        c, slope = 1 / 12 + s / 720 + s * s / 30240, 1 / 720 + s / 15120 + s * s / 403200
        if s > 0.01:
            angle = math.sqrt(s)
            cotangent = 1.0 / math.tan(0.5 * angle)
            c = 1.0 / s - 0.5 * cotangent / angle
            slope = 0.25 * (cotangent / angle + 0.5 * (1.0 + cotangent**2)) / s - 1.0 / (s * s)
        shift[0] = shift[1] = shift[2] = 0.0
        _add_seen(poses[heads[e]], poses[tails[e]], turn, shift)
        for i in range(3):
            for j in range(3):
                same = 1.0 if i == j else 0.0
                a = same + c * (w[i] * w[j] - s * same)
                b = c * (w[i] * u[j] + u[i] * w[j] - 2.0 * along * same)
                b += 2.0 * slope * along * (w[i] * w[j] - s * same)
                if i != j:
                    k = 3 - i - j
                    half = 0.5 if (j - i) % 3 == 2 else -0.5
                    a += half * w[k]
                    b += half * u[k]
                by_head[e, i, j] = by_head[e, 3 + i, 3 + j] = a
                by_head[e, 3 + i, j] = b
        for i in range(3):  # B + A [shift]
            for j in range(3):
                k, m = (j + 1) % 3, (j + 2) % 3
                mixed[i, j] = by_head[e, 3 + i, j]
                mixed[i, j] += by_head[e, i, k] * shift[m] - by_head[e, i, m] * shift[k]
        for i in range(3):
            for j in range(3):
                a, b = 0.0, 0.0
                for k in range(3):
                    a -= by_head[e, i, k] * turn[k, j]
                    b -= mixed[i, k] * turn[k, j]
                by_tail[e, i, j] = by_tail[e, 3 + i, 3 + j] = a
                by_tail[e, 3 + i, j] = b
