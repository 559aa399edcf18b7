"""Rays in the plane against line segments, sorted into square cells that each ray walks through.

Amanatides and Woo, "A fast voxel traversal algorithm for ray tracing", Eurographics 1987.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from mapmyworld.kernels.compiling import inner_jit, jit

_EPSILON = 1e-12


@inner_jit
def _hit_distance(x: float, y: float, dx: float, dy: float, segment: NDArray[np.float64]) -> float:
    """Distance along the unit ray to a segment; infinite where it misses."""
    ex, ey = segment[2] - segment[0], segment[3] - segment[1]
    determinant = dx * ey - dy * ex
    if abs(determinant) < _EPSILON:
        return np.inf
    ox, oy = segment[0] - x, segment[1] - y
    distance = (ox * ey - oy * ex) / determinant
    along = (ox * dy - oy * dx) / determinant
    if distance < 0.0 or along < -1e-9 or along > 1.0 + 1e-9:
        return np.inf
    return float(distance)


@inner_jit
def _entry(
    x: float,
    y: float,
    dx: float,
    dy: float,
    corner: NDArray[np.float64],
    size: NDArray[Any],
) -> float:
    """Distance at which a ray comes, by a hair, into the rectangle of cells; 0 if it is inside."""
    enter = 0.0
    for start, way, low, extent in ((x, dx, corner[0], size[0]), (y, dy, corner[1], size[1])):
        if abs(way) > _EPSILON:
            first = min((low - start) / way, (low + extent - start) / way)
            if first > 0.0:
                enter = max(enter, first + 1e-9)
    return enter


@jit
def cast_planar_rays(
    rays: NDArray[np.float64],
    segments: NDArray[np.float64],
    cell_starts: NDArray[np.int64],
    cell_segments: NDArray[np.int64],
    corner: NDArray[np.float64],
    cell: float,
    shape: NDArray[np.int64],
    ranges: NDArray[np.float64],
    hits: NDArray[np.int64],
) -> None:
    """Fills `ranges` (infinite = nothing) and `hits` (-1 = nothing), (N,) both, of rays (N, 3).

    A ray is x, y, angle; in m and rad. `segments` (S, 4), `cell_starts` (C + 1,), `cell_segments`
    (K,), `corner` (2,) and `shape` (2,) are those of a `Plan`.
    """
    for i in range(len(rays)):
        x, y = rays[i, 0], rays[i, 1]
        dx, dy = np.cos(rays[i, 2]), np.sin(rays[i, 2])
        ranges[i], hits[i] = np.inf, -1
        enter = _entry(x, y, dx, dy, corner, cell * shape)
        column = int(np.floor((x + enter * dx - corner[0]) / cell))
        row = int(np.floor((y + enter * dy - corner[1]) / cell))
        step_x, step_y = 1 if dx > 0 else -1, 1 if dy > 0 else -1
        edge_x = corner[0] + (column + (1 if dx > 0 else 0)) * cell
        edge_y = corner[1] + (row + (1 if dy > 0 else 0)) * cell
        next_x = (edge_x - x) / dx if abs(dx) > _EPSILON else np.inf
        next_y = (edge_y - y) / dy if abs(dy) > _EPSILON else np.inf
        per_x = cell / abs(dx) if abs(dx) > _EPSILON else np.inf
        per_y = cell / abs(dy) if abs(dy) > _EPSILON else np.inf
        while 0 <= column < shape[0] and 0 <= row < shape[1]:
            key = row * shape[0] + column
            for k in range(cell_starts[key], cell_starts[key + 1]):
                distance = _hit_distance(x, y, dx, dy, segments[cell_segments[k]])
                if distance < ranges[i]:
                    ranges[i], hits[i] = distance, cell_segments[k]
            leave = min(next_x, next_y)
            if ranges[i] <= leave:
                break
            if next_x < next_y:
                column += step_x
                next_x += per_x
            else:
                row += step_y
                next_y += per_y
