"""The best pose of a scan on a grid of likelihoods, found for certain by branch and bound.

Hess, Kohler, Rapp, Andor, "Real-time loop closure in 2D LIDAR SLAM", ICRA 2016: level k of the
pyramid holds, at each cell, the maximum over the 2^k x 2^k cells to the right and above, so a
lookup there bounds the score of all those shifts at once. A point scores no more than it did a
level higher, so a sum is given up as soon as what its points have lost since is too much.

The squares of the top level are bounded together, a little less tightly: what one point has in all
of them lies side by side in memory, and is added to their sums by vector instructions.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from mapmyworld.kernels.compiling import inner_jit, jit

FULL = 255  # likelihood of a cell that holds a surface
UNSEEN = FULL - FULL // 2
"""Of a cell that no beam passed: it speaks for no pose and against none."""
RESOLUTION = 0.1
"""m, of cells."""
LEVELS = 4
"""Of the pyramid: the coarsest bounds 0.8 m x 0.8 m of shifts."""
SQUARE = 1 << (LEVELS - 1)
"""Cells of these shifts, to each side; as many pad a grid on all sides."""
SIDE = 16
"""Squares of the pyramid's top level that are bounded together, on each side."""


@inner_jit
def _excess(
    level: NDArray[np.uint8],
    cells: NDArray[np.int32],
    column: int,
    row: int,
    most: NDArray[np.uint8],
    slack: int,
    values: NDArray[np.uint8],
) -> int:
    """By how much the sum over all points is more than it must be; 0 where it is not.

    It would be `slack` if every point had the `most` (N,) that it can have. What they have instead
    fills `values` (N,), up to the point that decides.
    """
    # Unsigned, so that one comparison finds cells on either side of the grid.
    height, width = np.uint64(level.shape[0]), np.uint64(level.shape[1])
    for i in range(len(cells)):
        x, y = np.uint64(cells[i, 0] + column), np.uint64(cells[i, 1] + row)
        value = UNSEEN
        if x < width and y < height:
            value = int(level[y, x])
        values[i] = value
        slack -= int(most[i]) - value
        if slack <= 0:
            return 0
    return slack


@inner_jit
def _add_bounds(
    strips: NDArray[np.int8],
    cells: NDArray[np.int32],
    column: int,
    row: int,
    shift: int,
    rows: int,
    sums: NDArray[np.int32],
) -> None:
    """Fills `sums` (SIDE * SIDE,) with what all points have more than unseen, square by square.

    At least: the points' `cells` (N, 2), shifted by `column` and `row`, are looked up in `strips`,
    `shift` bits coarser. Only so many `rows` of squares are summed.
    """
    count, _, height, _ = strips.shape
    flat = strips.reshape(-1)
    for k in range(rows * SIDE):
        sums[k] = 0
    for i in range(len(cells)):
        x, y = (cells[i, 0] + column) >> shift, (cells[i, 1] + row) >> shift
        strip, line = x + 2 * SIDE, y >> 1
        first, last = max(0, -line), min(rows, height - line)
        if strip < 0 or strip >= count or first >= last:
            continue
        # Unsigned, so that nothing is counted from the end, and the loop becomes a vector's.
        begin = np.uint64((((strip * 2 + (y & 1)) * height) + line + first) * SIDE)
        own = np.uint64(first * SIDE)
        for k in range((last - first) * SIDE):
            sums[own + np.uint64(k)] += np.int32(flat[begin + np.uint64(k)])


@jit
def best_shift(
    pyramid: NDArray[np.uint8],
    strips: NDArray[np.int8],
    points: NDArray[np.float64],
    corner: NDArray[np.float64],
    guess: NDArray[np.float64],
    blocks: NDArray[np.int64],
    side: int,
    reach: int,
    angles: NDArray[np.float64],
    least: float,
    avoid: NDArray[np.float64],
    result: NDArray[np.float64],
) -> None:
    """Fills `result` (4,), score, x, y, yaw, with the best pose that scores above `least`.

    It lays `points` (N, 2), m, on level 0 of the `pyramid` (L, H, W), whose first cell but for the
    padding is at `corner` (2,), m. Shifts are those in `blocks` (S, 2), lower left cells from
    `guess` (3,) of `side` x `side` squares as large as those of the top of the pyramid, up to
    `reach` cells to the right and above, at the yaws `guess + angles`, `angles` (A,) in rad. Poses
    within `avoid` (5,), x, y, yaw, metres, radians, are left out. `strips` (X, 2, Y, SIDE) bound
    the top level for a row of squares: each next one is two of their cells on, and so are the rows
    of Y.
    """
    top, count = pyramid.shape[0] - 1, len(points)
    cells = np.empty((count, 2), np.int32)
    best = int(least * FULL * count)
    result[0] = least
    roots, bounds, found = np.empty((256, 3), np.int32), np.empty(256, np.int64), 0
    values = np.empty((top + 1, 4, count), np.uint8)  # of nodes on the way down, by their place
    full, sums = np.full(count, FULL, np.uint8), np.empty(SIDE * SIDE, np.int32)
    for turn in range(len(angles)):
        _place(points, guess, angles[turn], corner, cells)
        for block in range(len(blocks)):
            left, low = blocks[block, 0], blocks[block, 1]
            rows = min(side, (reach - low) // SQUARE + 1)
            columns = min(side, (reach - left) // SQUARE + 1)
            _add_bounds(strips, cells, left, low, top - 1, rows, sums)
            for k in range(rows * SIDE):
                if k % SIDE >= columns or sums[k] + UNSEEN * count <= best:
                    continue
                column, row = left + k % SIDE * SQUARE, low + k // SIDE * SQUARE
                excess = _excess(
                    pyramid[top], cells, column, row, full, FULL * count - best, values[top, 0]
                )
                if excess <= 0:
                    continue
                if found == len(roots):
                    roots, bounds = _twice_as_long(roots, bounds)
                roots[found, 0], roots[found, 1], roots[found, 2] = turn, column, row
                bounds[found] = best + excess
                found += 1
    stack, upper = np.empty((256, 4), np.int64), np.empty(256, np.int64)
    order = np.empty(found, np.int64)
    _highest_first(bounds, order)
    for root in order:
        if bounds[root] <= best:
            break
        turn = roots[root, 0]
        _place(points, guess, angles[turn], corner, cells)
        column, row = roots[root, 1], roots[root, 2]
        _excess(pyramid[top], cells, column, row, full, FULL * count, values[top, 0])
        stack[0, 0], stack[0, 1], stack[0, 2], stack[0, 3] = top, column, row, 0
        upper[0], depth = bounds[root], 1
        while depth > 0:
            depth -= 1
            if upper[depth] <= best:
                continue
            level, column, row = stack[depth, 0], stack[depth, 1], stack[depth, 2]
            if level == 0:
                x, y = guess[0] + column * RESOLUTION, guess[1] + row * RESOLUTION
                yaw = guess[2] + angles[turn]
                apart = abs((yaw - avoid[2] + np.pi) % (2.0 * np.pi) - np.pi)
                if np.hypot(x - avoid[0], y - avoid[1]) >= avoid[3] or apart >= avoid[4]:
                    best = upper[depth]
                    result[0], result[1] = best / (FULL * count), x
                    result[2], result[3] = y, yaw
                continue
            most = values[level, stack[depth, 3]]
            half, bottom, above = 1 << (level - 1), depth, upper[depth]
            for a in range(2):
                for b in range(2):
                    c, r, own = column + a * half, row + b * half, 2 * a + b
                    if c > reach or r > reach:
                        continue
                    finer = values[level - 1, own]
                    excess = _excess(pyramid[level - 1], cells, c, r, most, above - best, finer)
                    if excess <= 0:
                        continue
                    bound = best + excess
                    k = depth  # the most promising comes to the top of the stack
                    while k > bottom and upper[k - 1] > bound:
                        upper[k] = upper[k - 1]
                        for i in range(4):
                            stack[k, i] = stack[k - 1, i]
                        k -= 1
                    upper[k] = bound
                    stack[k, 0], stack[k, 1], stack[k, 2], stack[k, 3] = level - 1, c, r, own
                    depth += 1


@inner_jit
def _twice_as_long(
    roots: NDArray[np.int32], bounds: NDArray[np.int64]
) -> tuple[NDArray[np.int32], NDArray[np.int64]]:
    """The same rows (R, 3) and (R,), with room for as many more."""
    more, higher = np.empty((2 * len(roots), 3), np.int32), np.empty(2 * len(roots), np.int64)
    for k in range(len(roots)):
        higher[k] = bounds[k]
        for i in range(3):
            more[k, i] = roots[k, i]
    return more, higher


@inner_jit
def _highest_first(values: NDArray[np.int64], order: NDArray[np.int64]) -> None:
    """Fills `order` with the places of its length's first values, equal ones as they come.

    By counting: the values are small, and numba's own sort takes seconds to compile.
    """
    most = 0
    for i in range(len(order)):
        most = max(most, values[i])
    ends = np.zeros(most + 2, np.int64)
    for i in range(len(order)):
        ends[most - values[i] + 1] += 1
    for value in range(most + 1):
        ends[value + 1] += ends[value]
    for i in range(len(order)):
        order[ends[most - values[i]]] = i
        ends[most - values[i]] += 1


@inner_jit
def _place(
    points: NDArray[np.float64],
    guess: NDArray[np.float64],
    angle: float,
    corner: NDArray[np.float64],
    cells: NDArray[np.int32],
) -> None:
    c, s = np.cos(guess[2] + angle), np.sin(guess[2] + angle)
    for i in range(len(points)):
        x = c * points[i, 0] - s * points[i, 1] + guess[0] - corner[0]
        y = s * points[i, 0] + c * points[i, 1] + guess[1] - corner[1]
        cells[i, 0] = np.int32(np.floor(x / RESOLUTION)) + SQUARE
        cells[i, 1] = np.int32(np.floor(y / RESOLUTION)) + SQUARE
