"""Inner loops of localisation: rays through a grid, scores of many poses in a field."""

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

    Everything is in cells, of grids (H, W). A ray, of which `bearings` (N,) gives the direction,
    that leaves what is known, or `reach`, hits nothing.
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
def field_scores(
    first: int,
    last: int,
    field: NDArray[np.float32],
    free: NDArray[np.bool_],
    corner: NDArray[np.float64],
    resolution: float,
    points: NDArray[np.float64],
    poses: NDArray[np.float64],
    outside: float,
    scores: NDArray[np.float64],
) -> None:
    """Sums of `field` at the points (N, 2) seen from poses `first` to `last` (P, 3).

    A point beyond the field counts `outside`; a pose that does not stand on a free cell scores as
    if all its points lay there.
    """
    height, width = field.shape
    for p in range(first, last):
        c, s = np.cos(poses[p, 2]), np.sin(poses[p, 2])
        x, y = poses[p, 0] - corner[0], poses[p, 1] - corner[1]
        column, row = int(np.floor(x / resolution)), int(np.floor(y / resolution))
        inside = 0 <= row < height and 0 <= column < width and free[row, column]
        total = 0.0
        for i in range(len(points)):
            if not inside:
                total += outside
                continue
            u = int(np.floor((x + c * points[i, 0] - s * points[i, 1]) / resolution))
            v = int(np.floor((y + s * points[i, 0] + c * points[i, 1]) / resolution))
            total += field[v, u] if 0 <= v < height and 0 <= u < width else outside
        scores[p] = total


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
    """Counts of points (N, 2), map frame, that a map explains, contradicts, and does not cover.

    Explained is what ends within `limit` metres of a surface. Contradicted is what ends where the
    map is free (`state` 0), or beyond an occupied cell (100) seen from `eye` (2,).
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


@jit
def block_bounds(
    first: int,
    last: int,
    level: NDArray[np.float32],
    margin: int,
    blocks: NDArray[np.int64],
    points: NDArray[np.float64],
    angles: NDArray[np.float64],
    resolution: float,
    bounds: NDArray[np.float32],
) -> None:
    """`bounds[turn, b]`: what the scan scores at most with the robot in block `b`, at a heading.

    `level` (H, W) holds maxima over squares of the block's size; `blocks` (B, 2) are the blocks'
    lower left cells; turns `first` to `last` are done.
    """
    height, width = level.shape
    cells = np.empty((len(points), 2), np.int64)
    for turn in range(first, last):
        c, s = np.cos(angles[turn]), np.sin(angles[turn])
        for i in range(len(points)):
            cells[i, 0] = int(np.floor((c * points[i, 0] - s * points[i, 1]) / resolution)) + margin
            cells[i, 1] = int(np.floor((s * points[i, 0] + c * points[i, 1]) / resolution)) + margin
        for b in range(len(blocks)):
            total = 0.0
            for i in range(len(points)):
                x, y = cells[i, 0] + blocks[b, 0], cells[i, 1] + blocks[b, 1]
                if 0 <= x < width and 0 <= y < height:
                    total += level[y, x]
            bounds[turn, b] = total / len(points)


@jit
def best_in_blocks(
    first: int,
    last: int,
    finest: NDArray[np.float32],
    margin: int,
    side: int,
    blocks: NDArray[np.int64],
    turns: NDArray[np.int64],
    points: NDArray[np.float64],
    angles: NDArray[np.float64],
    resolution: float,
    best: NDArray[np.float64],
) -> None:
    """Rows `best[k]` (3,) = score, column, row of the best cell of block k at its heading.

    Of `points` (N, 2) in the grid `finest` (H, W), at `angles[turns[k]]` within the `side` cells
    from `blocks[k]` (2,) on.
    """
    height, width = finest.shape
    cells = np.empty((len(points), 2), np.int64)
    for k in range(first, last):
        c, s = np.cos(angles[turns[k]]), np.sin(angles[turns[k]])
        for i in range(len(points)):
            cells[i, 0] = int(np.floor((c * points[i, 0] - s * points[i, 1]) / resolution)) + margin
            cells[i, 1] = int(np.floor((s * points[i, 0] + c * points[i, 1]) / resolution)) + margin
        best[k, 0] = -1.0
        for dy in range(side):
            for dx in range(side):
                total = 0.0
                for i in range(len(points)):
                    x, y = cells[i, 0] + blocks[k, 0] + dx, cells[i, 1] + blocks[k, 1] + dy
                    if 0 <= x < width and 0 <= y < height:
                        total += finest[y, x]
                total /= len(points)
                if total > best[k, 0]:
                    best[k, 0] = total
                    best[k, 1], best[k, 2] = blocks[k, 0] + dx, blocks[k, 1] + dy
