"""The best pose of a scan on a grid of likelihoods, found for certain by branch and bound.

Hess, Kohler, Rapp, Andor, "Real-time loop closure in 2D LIDAR SLAM", ICRA 2016: level k of the
pyramid holds, at each cell, the maximum over the 2^k x 2^k cells to the right and above, so a
lookup there bounds the score of all those shifts at once.
"""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray


@njit(cache=True, nogil=True)
def _score(
    pyramid: NDArray[np.float32],
    level: int,
    cells: NDArray[np.int64],
    column: int,
    row: int,
    margin: int,
) -> float:
    height, width = pyramid.shape[1], pyramid.shape[2]
    total = 0.0
    for i in range(len(cells)):
        x, y = cells[i, 0] + column + margin, cells[i, 1] + row + margin
        if 0 <= x < width and 0 <= y < height:
            total += pyramid[level, y, x]
    return total / max(len(cells), 1)


@njit(cache=True, nogil=True)
def best_shift(
    pyramid: NDArray[np.float32],
    margin: int,
    points: NDArray[np.float64],
    corner: NDArray[np.float64],
    resolution: float,
    guess: NDArray[np.float64],
    reach: int,
    angles: NDArray[np.float64],
    least: float,
    avoid: NDArray[np.float64],
    result: NDArray[np.float64],
) -> None:
    """Fills `result` (score, x, y, yaw) with the best pose that scores above `least`.

    Shifts reach `reach` cells to each side of `guess`, at the yaws `guess + angles`. Poses within
    `avoid` = (x, y, yaw, metres, radians) are left out. `margin` cells pad the grid on all sides.
    """
    top = pyramid.shape[0] - 1
    side = 1 << top
    count = len(points)
    cells = np.empty((count, 2), np.int64)
    stack = np.empty((4096, 3), np.int64)
    result[0] = least
    # Every rotation's bound at the top, so that the most promising is searched first.
    starts = (2 * reach + side) // side
    bounds = np.empty(len(angles))
    for turn in range(len(angles)):
        _place(points, guess, angles[turn], corner, resolution, cells)
        bound = 0.0
        for a in range(starts):
            for b in range(starts):
                bound = max(bound, _score(pyramid, top, cells, a * side - reach,
                                          b * side - reach, margin))  # fmt: skip
        bounds[turn] = bound
    for turn in np.argsort(-bounds):
        if bounds[turn] <= result[0]:
            break
        _place(points, guess, angles[turn], corner, resolution, cells)
        depth = 0
        for a in range(starts):
            for b in range(starts):
                stack[depth, 0] = top
                stack[depth, 1], stack[depth, 2] = a * side - reach, b * side - reach
                depth += 1
        while depth > 0:
            depth -= 1
            level, column, row = stack[depth, 0], stack[depth, 1], stack[depth, 2]
            if column > reach or row > reach:
                continue
            score = _score(pyramid, level, cells, column, row, margin)
            if score <= result[0]:
                continue
            if level > 0:
                half = 1 << (level - 1)
                for a in range(2):
                    for b in range(2):
                        stack[depth, 0] = level - 1
                        stack[depth, 1], stack[depth, 2] = column + a * half, row + b * half
                        depth += 1
                continue
            x, y = guess[0] + column * resolution, guess[1] + row * resolution
            yaw = guess[2] + angles[turn]
            apart = abs((yaw - avoid[2] + np.pi) % (2.0 * np.pi) - np.pi)
            if np.hypot(x - avoid[0], y - avoid[1]) < avoid[3] and apart < avoid[4]:
                continue
            result[0], result[1], result[2], result[3] = score, x, y, yaw


@njit(cache=True, nogil=True)
def _place(
    points: NDArray[np.float64],
    guess: NDArray[np.float64],
    angle: float,
    corner: NDArray[np.float64],
    resolution: float,
    cells: NDArray[np.int64],
) -> None:
    c, s = np.cos(guess[2] + angle), np.sin(guess[2] + angle)
    for i in range(len(points)):
        x = c * points[i, 0] - s * points[i, 1] + guess[0] - corner[0]
        y = s * points[i, 0] + c * points[i, 1] + guess[1] - corner[1]
        cells[i, 0], cells[i, 1] = np.floor(x / resolution), np.floor(y / resolution)
