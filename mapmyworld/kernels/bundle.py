"""Inner loops of bundle adjustment: normal equations of cameras and points, Schur complement."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from mapmyworld.kernels.compiling import jit

Array = NDArray[np.float64]
Indices = NDArray[np.int64]


@jit
def bundle_normal_equations(
    cameras: Array,
    points: Array,
    camera_of: Indices,
    point_of: Indices,
    seen: Array,
    sigmas: Array,
    width: float,
    camera_blocks: Array,
    camera_gradients: Array,
    point_blocks: Array,
    point_gradients: Array,
    cross_blocks: Array,
) -> float:
    """Fills the blocks of the normal equations and gives the robust cost (Huber from `width`).

    Cameras (K, 4, 4) are map_from_camera, perturbed on the right, rotation first; points (P, 3) in
    m, map frame. Each of M observations, a row of `seen` (M, 3) and of `sigmas` (M, k), is of a
    camera and a point, `camera_of` and `point_of` (M,). Blocks: (K, 6, 6), (K, 6), (P, 3, 3),
    (P, 3), and (M, 6, 3) for each observation. An observation is linearised as in
    `pose_normal_equations`, written out here as well: as a function of its own, shared by both
    loops, it takes 1.6 times as long.
    """
    camera_blocks[:] = 0.0
    camera_gradients[:] = 0.0
    point_blocks[:] = 0.0
    point_gradients[:] = 0.0
    cost = 0.0
    j = np.zeros((3, 9))
    residual = np.zeros(3)
    weights = np.zeros(3)
    for i in range(len(camera_of)):
        c, p = camera_of[i], point_of[i]
        pose = cameras[c]
        dx, dy, dz = points[p, 0] - pose[0, 3], points[p, 1] - pose[1, 3], points[p, 2] - pose[2, 3]
        z = pose[0, 2] * dx + pose[1, 2] * dy + pose[2, 2] * dz
        if z < 1e-3:
            cross_blocks[i] = 0.0
            cost += 1e4
            continue
        q = 1.0 / z
        x = (pose[0, 0] * dx + pose[1, 0] * dy + pose[2, 0] * dz) * q
        y = (pose[0, 1] * dx + pose[1, 1] * dy + pose[2, 1] * dz) * q
        j[0, 0], j[0, 1], j[0, 2] = x * y, -(1.0 + x * x), y
        j[0, 3], j[0, 4], j[0, 5] = -q, 0.0, x * q
        j[1, 0], j[1, 1], j[1, 2] = 1.0 + y * y, -x * y, -x
        j[1, 3], j[1, 4], j[1, 5] = 0.0, -q, y * q
        j[2, 0], j[2, 1], j[2, 2] = y * q, -x * q, 0.0
        j[2, 3], j[2, 4], j[2, 5] = 0.0, 0.0, q * q
        for k in range(3):
            for m in range(3):  # the point moves against the camera's translation, turned
                j[k, 6 + m] = -(j[k, 3] * pose[m, 0] + j[k, 4] * pose[m, 1] + j[k, 5] * pose[m, 2])
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
        for m in range(6):
            for n in range(3):
                cross_blocks[i, m, n] = 0.0
        for k in range(3):
            for m in range(6):
                weighted = weights[k] * j[k, m]
                camera_gradients[c, m] += weighted * residual[k]
                for n in range(m, 6):
                    camera_blocks[c, m, n] += weighted * j[k, n]
                for n in range(3):
                    cross_blocks[i, m, n] += weighted * j[k, 6 + n]
            for m in range(3):
                weighted = weights[k] * j[k, 6 + m]
                point_gradients[p, m] += weighted * residual[k]
                for n in range(3):
                    point_blocks[p, m, n] += weighted * j[k, 6 + n]
    for c in range(len(cameras)):
        for m in range(6):
            for n in range(m):
                camera_blocks[c, m, n] = camera_blocks[c, n, m]
    return cost


@jit
def eliminate_points(
    point_blocks: Array,
    damping: float,
    cross_blocks: Array,
    point_of: Indices,
    inverse: Array,
    scaled: Array,
) -> None:
    """Fills `inverse` with those of the damped blocks, and `scaled` with cross blocks times them.

    `point_blocks` and `inverse` (P, 3, 3), `cross_blocks` and `scaled` (M, 6, 3); `point_of` (M,)
    is each observation's point.
    """
    for p in range(len(point_blocks)):
        h = point_blocks[p]
        extra = damping * (h[0, 0] + h[1, 1] + h[2, 2]) / 3.0 + 1e-6
        a, b, c = h[0, 0] + extra, h[0, 1], h[0, 2]
        d, e, f = h[1, 1] + extra, h[1, 2], h[2, 2] + extra
        m00, m01, m02 = d * f - e * e, c * e - b * f, b * e - c * d
        scale = 1.0 / (a * m00 + b * m01 + c * m02)
        inverse[p, 0, 0], inverse[p, 0, 1], inverse[p, 0, 2] = m00 * scale, m01 * scale, m02 * scale
        inverse[p, 1, 1] = (a * f - c * c) * scale
        inverse[p, 1, 2] = (b * c - a * e) * scale
        inverse[p, 2, 2] = (a * d - b * b) * scale
        inverse[p, 1, 0], inverse[p, 2, 0] = inverse[p, 0, 1], inverse[p, 0, 2]
        inverse[p, 2, 1] = inverse[p, 1, 2]
    for i in range(len(point_of)):
        q = inverse[point_of[i]]
        for m in range(6):
            x, y, z = cross_blocks[i, m, 0], cross_blocks[i, m, 1], cross_blocks[i, m, 2]
            for n in range(3):
                scaled[i, m, n] = x * q[0, n] + y * q[1, n] + z * q[2, n]


@jit
def subtract_gradients(
    scaled: Array, point_gradients: Array, point_of: Indices, slot_of: Indices, gradient: Array
) -> None:
    """Subtracts from the cameras' `gradient` (F, 6) what the points explain.

    `scaled` (M, 6, 3) as of `eliminate_points`, `point_gradients` (P, 3); each observation has its
    point, `point_of`, and its camera's row in the gradient, `slot_of`, -1 if fixed; (M,) both.
    """
    for i in range(len(point_of)):
        if slot_of[i] >= 0:
            g = point_gradients[point_of[i]]
            for m in range(6):
                explained = scaled[i, m, 0] * g[0] + scaled[i, m, 1] * g[1] + scaled[i, m, 2] * g[2]
                gradient[slot_of[i], m] -= explained


@jit
def move_points(
    inverse: Array,
    cross_blocks: Array,
    tangents: Array,
    camera_of: Indices,
    point_of: Indices,
    right: Array,
    points: Array,
) -> None:
    """Moves points (P, 3) to where they fit best after their cameras' tangents (K, 6).

    `inverse` (P, 3, 3) as of `eliminate_points`, `cross_blocks` (M, 6, 3) of cameras `camera_of`
    and points `point_of`, (M,) both. `right` (P, 3) comes as the points' gradients and is used up.
    """
    for i in range(len(point_of)):
        for n in range(3):
            pull = 0.0
            for m in range(6):
                pull += cross_blocks[i, m, n] * tangents[camera_of[i], m]
            right[point_of[i], n] += pull
    for p in range(len(points)):
        for m in range(3):
            for n in range(3):
                points[p, m] -= inverse[p, m, n] * right[p, n]


@jit
def subtract_points(
    starts: Indices,
    slot_of: Indices,
    cross_blocks: Array,
    scaled_blocks: Array,
    reduced: Array,
) -> None:
    """Subtracts from the cameras' matrix (6F, 6F) what the points explain, lower half only.

    Observations are sorted by point, `starts` (P + 1,) where each point's begin; `slot_of` (M,) is
    the row of blocks of the observation's camera, -1 where it stays fixed. `scaled_blocks` are the
    `cross_blocks` times the inverse of the point's block, (M, 6, 3) both.
    """
    for p in range(len(starts) - 1):
        for a in range(starts[p], starts[p + 1]):
            row = slot_of[a] * 6
            if row < 0:
                continue
            for b in range(starts[p], starts[p + 1]):
                column = slot_of[b] * 6
                if column < 0 or column > row:
                    continue
                for m in range(6):
                    for n in range(6):
                        reduced[row + m, column + n] -= (
                            scaled_blocks[a, m, 0] * cross_blocks[b, n, 0]
                            + scaled_blocks[a, m, 1] * cross_blocks[b, n, 1]
                            + scaled_blocks[a, m, 2] * cross_blocks[b, n, 2]
                        )
