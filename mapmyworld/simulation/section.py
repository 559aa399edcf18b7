"""The plan of a scene at one height: the line segments that a planar laser meets."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

_TOUCH = 1e-9  # m by which vertices on the plane are lifted, so that each triangle is cut once


def horizontal_section(
    corners: NDArray[np.float64], height: float
) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
    """Segments (S, 4) as x0, y0, x1, y1 where triangles (T, 3, 3) cross z = height, and (S,) whose.

    All in m; corners of triangles are rows.
    """
    z = corners[:, :, 2] - height
    z = np.where(np.abs(z) < _TOUCH, _TOUCH, z)
    owner = np.flatnonzero((z.min(1) < 0.0) & (z.max(1) > 0.0))
    segments = np.zeros((len(owner), 2, 2))
    filled = np.zeros(len(owner), np.int64)
    for a, b in ((0, 1), (1, 2), (2, 0)):
        za, zb = z[owner, a], z[owner, b]
        crosses = np.flatnonzero((za < 0.0) != (zb < 0.0))
        share = za[crosses] / (za[crosses] - zb[crosses])
        start, end = corners[owner[crosses], a, :2], corners[owner[crosses], b, :2]
        segments[crosses, filled[crosses]] = start + share[:, None] * (end - start)
        filled[crosses] += 1
    return segments.reshape(-1, 4), owner
