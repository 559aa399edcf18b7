"""Surfaces seen in a depth image: their normals, and whether another image looks through them."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from mapmyworld.kernels.compiling import jit
from mapmyworld.kernels.projection import project

Array = NDArray[np.float64]
Array32 = NDArray[np.float32]


@jit
def surface_normals(points: Array32, normals: Array32, cosines: Array32) -> None:
    """Fills `normals` (H, W, 3) and `cosines` (H, W) of `organised_normals`; both come as zeros.

    `points` (H, W, 3) in m, camera frame.
    """
    height, width = points.shape[:2]
    for v in range(1, height - 1):
        for u in range(1, width - 1):
            left, right = points[v, u - 1], points[v, u + 1]
            above, below = points[v - 1, u], points[v + 1, u]
            x, y, z = points[v, u, 0], points[v, u, 1], points[v, u, 2]
            if min(z, left[2], right[2], above[2], below[2]) <= 0.0:
                continue
            a0, a1, a2 = below[0] - above[0], below[1] - above[1], below[2] - above[2]
            b0, b1, b2 = right[0] - left[0], right[1] - left[1], right[2] - left[2]
            c0, c1, c2 = a1 * b2 - a2 * b1, a2 * b0 - a0 * b2, a0 * b1 - a1 * b0
            length = np.sqrt(c0 * c0 + c1 * c1 + c2 * c2)
            distance = np.sqrt(x * x + y * y + z * z)
            if length <= 1e-12:
                continue
            cosine = -(c0 * x + c1 * y + c2 * z) / (length * distance)
            sign = np.float32(-1.0 if cosine < 0.0 else 1.0) / length
            normals[v, u, 0], normals[v, u, 1], normals[v, u, 2] = c0 * sign, c1 * sign, c2 * sign
            cosines[v, u] = abs(cosine)


@jit
def compare_with_depth(
    points: Array,
    camera_from_points: Array,
    intrinsics: Array,
    bent: int,
    distortion: Array,
    depth: Array32,
    factor: float,
    share: float,
    seen: NDArray[np.int32],
    pierced: NDArray[np.int32],
) -> None:
    """Counts up `seen` (N,) where a depth image shows a point (N, 3) within `share` of its depth,
    and `pierced` (N,) where it shows something beyond.

    `camera_from_points` (4, 4), `intrinsics` (3, 3), `distortion` (12,) as of `project`; `depth`
    (H, W) in m, 0 unknown. `factor`: pixels of the camera in one of depth.
    """
    m = camera_from_points
    rows, columns = depth.shape
    for i in range(len(points)):
        x, y, z = points[i, 0], points[i, 1], points[i, 2]
        a = m[0, 0] * x + m[0, 1] * y + m[0, 2] * z + m[0, 3]
        b = m[1, 0] * x + m[1, 1] * y + m[1, 2] * z + m[1, 3]
        c = m[2, 0] * x + m[2, 1] * y + m[2, 2] * z + m[2, 3]
        if c <= 1e-6:
            continue
        u, v = project(a / c, b / c, intrinsics, bent, distortion)
        if not (abs(u) < 1e6 and abs(v) < 1e6):
            continue
        column = int(np.round((u + 0.5) / factor - 0.5))
        row = int(np.round((v + 0.5) / factor - 0.5))
        if column < 0 or row < 0 or column >= columns or row >= rows:
            continue
        there = depth[row, column]
        if not there > 0.0:
            continue
        excess = (there - c) / c
        if abs(excess) < share:
            seen[i] += 1
        elif excess > share:
            pierced[i] += 1
