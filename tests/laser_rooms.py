"""Two rooms of straight walls, and the scans that a laser takes in them."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from mapmyworld.types import Scan

# Two rooms joined by a door, with a pillar: walls as segments x0, y0, x1, y1 (m).
WALLS = np.array(
    [
        [-4, -3, 6, -3], [6, -3, 6, 4], [6, 4, -4, 4], [-4, 4, -4, -3],
        [1, 4, 1, 1.2], [1, -3, 1, 0], [3, 1, 3.5, 1], [3.5, 1, 3.5, 1.5], [3.5, 1.5, 3, 1.5],
        [3, 1.5, 3, 1], [-4, 2.5, -3, 2.5], [-3, 2.5, -3, 4],
    ],
    np.float64,
)  # fmt: skip


def cast(pose: NDArray[np.float64], walls: NDArray[np.float64], seed: int) -> Scan:
    """A half turn of half-degree beams with 1 cm of noise, by intersecting every wall."""
    angles = np.radians(np.arange(-90.0, 90.01, 0.5))
    direction = np.stack([np.cos(angles + pose[2]), np.sin(angles + pose[2])], axis=-1)
    along = walls[:, 2:] - walls[:, :2]
    offset = walls[:, :2] - pose[:2]
    cross = direction[:, None, 0] * along[:, 1] - direction[:, None, 1] * along[:, 0]
    with np.errstate(divide="ignore", invalid="ignore"):
        ranges = (offset[:, 0] * along[:, 1] - offset[:, 1] * along[:, 0]) / cross
        place = offset[:, 0] * direction[:, None, 1] - offset[:, 1] * direction[:, None, 0]
        place = place / cross
    hit = (ranges > 0) & (place >= 0) & (place <= 1)
    nearest = np.where(hit, ranges, np.inf).min(axis=1)
    nearest = nearest + np.random.default_rng(seed).normal(size=len(nearest)) * 0.01
    seen = nearest < 8.0
    points = nearest[seen, None] * np.stack([np.cos(angles), np.sin(angles)], axis=-1)[seen]
    return Scan(
        points.astype(np.float32), np.zeros(3), np.zeros(0, np.float32), 8.0, np.radians(0.5)
    )
