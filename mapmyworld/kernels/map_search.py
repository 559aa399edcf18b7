"""Inner loops of localisation: rays through a grid, and how points go with it."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from mapmyworld.kernels.compiling import jit


@jit
def cast_rays(
    occupied: NDArray[np.bool_],
    known: NDArray[np.bool_],
    x: float,
    y: float,
    bearings: NDArray[np.float64],
    reach: float,
    hits: NDArray[np.float64],
) -> int:
    """Fills `hits` (N, 2) with the middles of the first occupied cells along rays; gives their
    count.

    Everything is in cells, of grids `occupied` and `known` (H, W). A ray, of which `bearings` (N,)
    gives the direction in rad, that leaves what is known, or `reach`, hits nothing.
    """
    height, width = occupied.shape
    count = 0
    for k in range(len(bearings)):
        c, s = np.cos(bearings[k]), np.sin(bearings[k])
        travelled = 0.0
        while travelled < reach:
            column, row = int(np.floor(x + travelled * c)), int(np.floor(y + travelled * s))
            if row < 0 or column < 0 or row >= height or column >= width:
                break
            if occupied[row, column]:
                hits[count, 0], hits[count, 1] = column + 0.5, row + 0.5
                count += 1
                break
            if not known[row, column]:
                break
            travelled += 0.5
    return count


@jit
def explain_points(
    distance: NDArray[np.float32],
    state: NDArray[np.int8],
    corner: NDArray[np.float64],
    resolution: float,
    points: NDArray[np.float64],
    eye: NDArray[np.float64],
    limit: float,
    counts: NDArray[np.int64],
) -> None:
    """Counts (3,) of points (N, 2), map frame, that a map explains, contradicts, or does not know.

    Explained is what ends within `limit` of a surface, to which `distance` (H, W) is in metres.
    Contradicted is what ends where the map is free (`state` (H, W) is 0), or beyond an occupied
    cell (100) seen from `eye` (2,). The first cell is at `corner` (2,); both in m, map frame.
    """
    height, width = distance.shape
    ex, ey = (eye[0] - corner[0]) / resolution, (eye[1] - corner[1]) / resolution
    counts[:] = 0
    for i in range(len(points)):
        x = (points[i, 0] - corner[0]) / resolution
        y = (points[i, 1] - corner[1]) / resolution
        column, row = int(np.floor(x)), int(np.floor(y))
        inside = 0 <= row < height and 0 <= column < width
        if inside and distance[row, column] <= limit:
            counts[0] += 1
            continue
        if inside and state[row, column] == 0:
            counts[1] += 1
            continue
        length = np.hypot(x - ex, y - ey)
        steps = int(length / 0.7) + 1
        last = steps - int(limit / resolution)
        crossed = False
        for k in range(1, last):
            u = int(np.floor(ex + (x - ex) * k / steps))
            v = int(np.floor(ey + (y - ey) * k / steps))
            if 0 <= v < height and 0 <= u < width and state[v, u] == 100:
                crossed = True
                break
        counts[1 if crossed else 2] += 1
