"""Point-to-line alignment of a scan with other scans, by bearing-ordered nearest neighbours.

Censi, "An ICP variant using a point-to-line metric", ICRA 2008: a scan seen from one origin is
sorted by bearing, so the search for a nearest neighbour ends where the ray is farther than the
best point found. Tangents are (x, y, yaw) and perturb on the right.

The lines' normals err. Squared, their errors never cancel: along a bare wall normal equations seem
to know what is noise alone, and all scans alike are pulled together. That is taken off, as errors
in variables are (Fuller, "Measurement error models", 1987).
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from mapmyworld.kernels.compiling import inner_jit, jit
from mapmyworld.kernels.planar_algebra import relative, solve3

_PATIENCE = 12  # rows walked from the last point's place before the bearing is looked up

Rows = NDArray[np.float32]
"""(N, 6): x, y, normal x, normal y, bearing about the lidar, sorted by it; the variance of the
normal's direction, rad^2."""


@inner_jit
def first_beyond(rows: Rows, first: int, last: int, bearing: float) -> int:
    """The first of `rows[first:last]` (N, 6) of a bearing not below `bearing`; `last` if none."""
    low, high = first, last
    while low < high:
        middle = (low + high) >> 1
        if rows[middle, 4] < bearing:
            low = middle + 1
        else:
            high = middle
    return low


@jit
def nearest(rows: Rows, first: int, last: int, x: float, y: float, ox: float, oy: float,
            reach: float, start: int) -> tuple[int, int]:  # fmt: skip
    """Row of `rows[first:last]` (N, 6) nearest to (x, y) within `reach` metres; -1 if none is.

    `start` is a row at about the point's bearing, where the search begins: -1 if none is known. The
    second result is that row for a next point nearby.
    """
    count = last - first
    if count <= 0:
        return -1, -1
    x, y = x - ox, y - oy
    walked = _PATIENCE if start < 0 else 0
    while walked < _PATIENCE:
        rx, ry = rows[start, 0] - ox, rows[start, 1] - oy
        before = start - 1 if start > first else last - 1
        bx, by = rows[before, 0] - ox, rows[before, 1] - oy
        if x * ry - y * rx < 0.0:
            start = start + 1 if start + 1 < last else first
        elif x * by - y * bx >= 0.0:
            start = before
        else:
            break
        walked += 1
    if walked >= _PATIENCE:
        start = first_beyond(rows, first, last, np.arctan2(y, x))
        start = first if start == last else start
    best, found = reach * reach, -1
    for side in range(2):
        k = start if side == 0 else start - 1
        for _ in range(count):
            if k >= last:
                k = first
            elif k < first:
                k = last - 1
            rx, ry = rows[k, 0] - ox, rows[k, 1] - oy
            ahead, aside = x * rx + y * ry, x * ry - y * rx
            # All rows further on lie beyond this ray, and so at least its distance away.
            if ahead <= 0.0 or aside * aside > best * (rx * rx + ry * ry):
                break
            squared = (rx - x) * (rx - x) + (ry - y) * (ry - y)
            if squared < best:
                best, found = squared, k
            k = k + 1 if side == 0 else k - 1
    return found, start


@inner_jit
def add_target(
    source: Rows,
    s_first: int,
    s_last: int,
    target: Rows,
    t_first: int,
    t_last: int,
    origin: NDArray[np.float64],
    target_from_source: NDArray[np.float64],
    reach: float,
    scale: float,
    system: NDArray[np.float64],
    hit: NDArray[np.bool_],
) -> None:
    """Adds a target's normal equations to `system` (15,), marks the source points it explains.

    The points are rows `s_first` to `s_last` of `source` (N, 6), marked in `hit` (K,) from 0 on;
    rows of the `target` (M, 6) were seen from `origin` (2,); `target_from_source` (3,). `system`
    holds the upper triangle of the Hessian (6), the gradient (3), sums of weights, of weighted
    squared residuals (m^2), and of residuals within 3 * `scale` (Cauchy's, metres); and what errors
    of normals add to the Hessian in x and y (3).
    """
    c, s = np.cos(target_from_source[2]), np.sin(target_from_source[2])
    tx, ty = target_from_source[0], target_from_source[1]
    start: Any = np.int64(-1)  # a bare -1 is a type of its own: the search would be compiled twice
    for i in range(s_first, s_last):
        px, py = np.float64(source[i, 0]), np.float64(source[i, 1])
        x, y = c * px - s * py + tx, s * px + c * py + ty
        k, start = nearest(target, t_first, t_last, x, y, origin[0], origin[1], reach, start)
        if k < 0:
            continue
        nx, ny = np.float64(target[k, 2]), np.float64(target[k, 3])
        if nx == 0.0 and ny == 0.0:
            continue
        ax, ay = c * nx + s * ny, c * ny - s * nx  # the normal in the source's frame
        straight = source[i, 2] != 0.0 or source[i, 3] != 0.0
        if straight and ax * source[i, 2] + ay * source[i, 3] < 0.7:
            continue
        residual = nx * (x - target[k, 0]) + ny * (y - target[k, 1])
        ratio = residual / scale
        weight = 1.0 / (1.0 + ratio * ratio)
        ar = px * ay - py * ax
        system[0] += weight * ax * ax
        system[1] += weight * ax * ay
        system[2] += weight * ax * ar
        system[3] += weight * ay * ay
        system[4] += weight * ay * ar
        system[5] += weight * ar * ar
        system[6] += weight * ax * residual
        system[7] += weight * ay * residual
        system[8] += weight * ar * residual
        noise = weight * np.float64(target[k, 5])
        system[12] += noise * ay * ay
        system[13] -= noise * ax * ay
        system[14] += noise * ax * ax
        system[9] += weight
        system[10] += weight * residual * residual
        if abs(ratio) < 3.0:
            system[11] += 1.0
            hit[i - s_first] = True


@inner_jit
def take_noise_off(system: NDArray[np.float64]) -> None:
    """Takes what errors of normals add from normal equations (15,), in the direction known least.

    What is left there counts by its share, for the gradient has errors of the same normals.
    """
    xx, xy, yy = system[0], system[1], system[3]
    half, root = 0.5 * (xx + yy), np.hypot(0.5 * (xx - yy), xy)
    angle = 0.5 * np.arctan2(2.0 * xy, xx - yy) + 0.5 * np.pi
    x, y, known = np.cos(angle), np.sin(angle), half - root
    noise = x * x * system[12] + 2.0 * x * y * system[13] + y * y * system[14]
    share = 1.0 - noise / known if noise < known else 0.0
    lost = (1.0 - share) * known
    system[0] -= lost * x * x
    system[1] -= lost * x * y
    system[3] -= lost * y * y
    lost = (1.0 - np.sqrt(share)) * (x * system[2] + y * system[4])
    system[2], system[4] = system[2] - lost * x, system[4] - lost * y
    lost = (1.0 - share) * (x * system[6] + y * system[7])
    system[6], system[7] = system[6] - lost * x, system[7] - lost * y


@jit
def align(
    source: Rows,
    s_first: int,
    s_last: int,
    targets: Rows,
    starts: NDArray[np.int64],
    ends: NDArray[np.int64],
    which: NDArray[np.int64],
    poses: NDArray[np.float64],
    origins: NDArray[np.float64],
    guess: NDArray[np.float64],
    prior_information: NDArray[np.float64],
    max_distances: NDArray[np.float64],
    share: float,
    sigma: float,
    out: NDArray[np.float64],
) -> None:
    """Aligns source rows with targets `which` (K,), rows `starts[w]` to `ends[w]`, at `poses`.

    `source` is (N, 6), `targets` (M, 6); `starts` and `ends` (T,), `poses` (T, 3) and `origins`
    (T, 2) are of the targets. The scan's `guess` (3,) is in the frame of `poses`, and pulls with
    `prior_information` (3, 3). Gauss-Newton, one step a reach of `max_distances` (R,), m, of which
    Cauchy's scale is a `share`. `out` (11,): pose (3), match Hessian (6, upper triangle, in units
    of residuals), share explained of source points with normals, mean squared residual.
    """
    pose = guess.copy()
    hit = np.zeros(s_last - s_first, np.bool_)
    system = np.zeros(15)
    a, b = np.empty((3, 3)), np.empty(3)
    rounds, turn = len(max_distances), 0
    while turn <= rounds:
        system[:] = 0.0
        hit[:] = False
        reach = max_distances[min(turn, rounds - 1)]
        scale = share * reach
        for w in which:
            add_target(source, s_first, s_last, targets, starts[w], ends[w], origins[w],
                       relative(poses[w], pose), reach, scale, system, hit)  # fmt: skip
        take_noise_off(system)
        if turn == rounds:
            break
        factor = 1.0 / (sigma * sigma * max(len(which), 1))
        a[0, 0], a[0, 1], a[0, 2] = system[0], system[1], system[2]
        a[1, 0], a[1, 1], a[1, 2] = system[1], system[3], system[4]
        a[2, 0], a[2, 1], a[2, 2] = system[2], system[4], system[5]
        off = relative(guess, pose)
        off[2] = (off[2] + np.pi) % (2.0 * np.pi) - np.pi
        for row in range(3):
            b[row] = -factor * system[6 + row]
            for column in range(3):
                # The frames of guess and pose differ by the small rotation `off[2]`: left out.
                a[row, column] = a[row, column] * factor + prior_information[row, column]
                b[row] -= prior_information[row, column] * off[column]
            a[row, row] += 1e-6
        step = solve3(a, b)
        c, s = np.cos(pose[2]), np.sin(pose[2])
        pose[0] += c * step[0] - s * step[1]
        pose[1] += s * step[0] + c * step[1]
        pose[2] += step[2]
        length = np.hypot(step[0], step[1]) + 2.0 * abs(step[2])
        if length < 2e-4 and turn + 2 < rounds:
            turn = rounds - 2  # converged at this reach: look at the finest once more
        turn += 1
    explained, straight = 0.0, 0.0
    for i in range(len(hit)):
        if source[s_first + i, 2] != 0.0 or source[s_first + i, 3] != 0.0:
            straight += 1.0
            explained += hit[i]
    out[0], out[1] = pose[0], pose[1]
    out[2] = (pose[2] + np.pi) % (2.0 * np.pi) - np.pi
    for k in range(6):
        out[3 + k] = system[k]
    out[9] = explained / max(straight, 1.0)
    out[10] = system[10] / max(system[9], 1e-9)
