"""Points of a laser's sweep, beam by beam."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from mapmyworld.kernels.compiling import jit


@jit
def returned_points(
    ranges: NDArray[np.float32], low: np.float32, high: np.float32, ways: NDArray[np.float64],
    base_from_lidar: NDArray[np.float64],
) -> tuple[NDArray[np.int64], NDArray[np.float64]]:  # fmt: skip
    """Beams (N,) of which the range lies between `low` and `high`, and points (N, 3) of the base.

    Of `ranges` (B,) along directions `ways` (B, 2) of the laser's plane, at `base_from_lidar`
    (4, 4).
    """
    mount, count = base_from_lidar, 0
    beams, points = np.empty(len(ranges), np.int64), np.empty((len(ranges), 3))
    for beam in range(len(ranges)):
        if low < ranges[beam] < high:
            for k in range(3):
                way = mount[k, 0] * ways[beam, 0] + mount[k, 1] * ways[beam, 1]
                points[count, k] = ranges[beam] * way + mount[k, 3]
            beams[count] = beam
            count += 1
    return beams[:count], points[:count]


@jit
def carried_on(
    points: NDArray[np.float64], velocity: NDArray[np.float64], seconds: NDArray[np.float64]
) -> None:
    """Moves points (N, 3) that a base saw `seconds` (N,) later, which moves at `velocity` (3,) in
    its plane, to its frame of before.

    It goes along an arc, whose chord lies halfway between the headings at its ends.
    """
    for n in range(len(points)):
        since, (x, y, _) = seconds[n], points[n]
        cosine, sine = np.cos(0.5 * velocity[2] * since), np.sin(0.5 * velocity[2] * since)
        ahead = cosine * x - sine * y + velocity[0] * since
        aside = sine * x + cosine * y + velocity[1] * since
        points[n, 0] = cosine * ahead - sine * aside
        points[n, 1] = sine * ahead + cosine * aside
