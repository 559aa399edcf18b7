"""Recorded poses between their samples, and a sweep's beams as points, freed of motion."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from mapmyworld.kernels.compiling import inner_jit, jit
from mapmyworld.kernels.searching import first_not_below

Array = NDArray[np.float64]
FOUND, NOT_COVERED, TOO_FAR_APART = 0, 1, 2
_SMALL_ANGLE = 1e-9  # rad, as in `geometry.rotations`


@jit
def interpolate_poses(
    stamps: NDArray[np.int64],
    values: Array,
    wanted: NDArray[np.int64],
    tolerance: int,
    poses: Array,
) -> int:
    """Poses at stamps `wanted` (M,), ns, into `poses` (M, 4, 4), which are zeros.

    Of samples, `values` (N, 3, 4), at `stamps` (N,), ascending. As `geometry.rigid.interpolate`:
    `NOT_COVERED` where no sample lies within the tolerance, `TOO_FAR_APART` where samples around
    one are turned by more than 120 degrees.
    """
    count = len(stamps)
    turn = np.empty((3, 3))
    for i in range(len(wanted)):
        stamp = wanted[i]
        after = min(first_not_below(stamps, stamp), count - 1)
        before = max(after - 1 if stamps[after] > stamp else after, 0)
        if min(abs(stamps[before] - stamp), abs(stamps[after] - stamp)) > tolerance:
            return NOT_COVERED
        span = max(float(stamps[after] - stamps[before]), 1.0)
        share = min(max((stamp - stamps[before]) / span, 0.0), 1.0)
        a, b = values[before], values[after]
        if not _turned_part(a, b, share, turn):
            return TOO_FAR_APART
        pose = poses[i]
        for r in range(3):
            for c in range(3):
                pose[r, c] = a[r, 0] * turn[0, c] + a[r, 1] * turn[1, c] + a[r, 2] * turn[2, c]
            pose[r, 3] = (1.0 - share) * a[r, 3] + share * b[r, 3]
        pose[3, 3] = 1.0
    return FOUND


@inner_jit
def _turned_part(a: Array, b: Array, share: float, turn: Array) -> bool:
    """Into `turn` (3, 3) a share of the rotation from a to b; false beyond 120 degrees."""
    for r in range(3):
        for c in range(3):
            turn[r, c] = a[0, r] * b[0, c] + a[1, r] * b[1, c] + a[2, r] * b[2, c]
    x, y, z = turn[2, 1] - turn[1, 2], turn[0, 2] - turn[2, 0], turn[1, 0] - turn[0, 1]
    sine = 0.5 * np.sqrt(x * x + y * y + z * z)
    cosine = 0.5 * (turn[0, 0] + turn[1, 1] + turn[2, 2] - 1.0)
    if cosine < -0.5:
        return False
    angle = share * np.arctan2(sine, cosine)
    scale = 0.5 * share
    first, second = 1.0, 0.5
    if sine >= _SMALL_ANGLE:
        scale = 0.5 * angle / sine
    if angle >= _SMALL_ANGLE:
        first, second = np.sin(angle) / angle, (1.0 - np.cos(angle)) / angle**2
    x, y, z = x * scale, y * scale, z * scale
    turn[0, 0], turn[1, 1] = 1.0 - second * (y * y + z * z), 1.0 - second * (x * x + z * z)
    turn[2, 2] = 1.0 - second * (x * x + y * y)
    turn[0, 1], turn[1, 0] = second * x * y - first * z, second * x * y + first * z
    turn[0, 2], turn[2, 0] = second * x * z + first * y, second * x * z - first * y
    turn[1, 2], turn[2, 1] = second * y * z - first * x, second * y * z + first * x
    return True


@jit
def sort_beams(
    ranges: NDArray[np.float32],
    least: float,
    most: float,
    directions: Array,
    origin: Array,
    points: Array,
    returned: NDArray[np.int64],
    empty: NDArray[np.int64],
) -> tuple[int, int]:
    """Beams (N,) between the `least` and the `most` range as `points` (N, 3); how many these are.

    From `origin` (3,) in `directions` (N, 3), unit vectors; all in m. `returned`: numbers of their
    beams; `empty`: numbers, and the second result, of beams that came back with nothing; (N,) both.
    Limits are compared as single precision, as the ranges are.
    """
    low, high = np.float32(least), np.float32(most)
    found, nothing = 0, 0
    for beam in range(len(ranges)):
        away = ranges[beam]
        if low < away < high and np.isfinite(away):
            for c in range(3):
                points[found, c] = away * directions[beam, c] + origin[c]
            returned[found] = beam
            found += 1
        elif away >= high or away == 0.0 or away == np.inf:
            empty[nothing] = beam
            nothing += 1
    return found, nothing


@jit
def move_beams(points: Array, beams: NDArray[np.int64], step: float, moved: Array) -> None:
    """Points (N, 3) moved by the motion (K, 4, 4) at their beams' (N,) places between knots.

    `step`: knots per beam; beams between two knots move in straight lines.
    """
    last = len(moved) - 1
    for i in range(len(points)):
        place = min(max(beams[i] * step, 0.0), float(last))
        lower = min(int(place), last - 1)
        share = place - lower
        a, b = moved[lower], moved[lower + 1]
        x, y, z = points[i, 0], points[i, 1], points[i, 2]
        for r in range(3):
            at_a = a[r, 0] * x + a[r, 1] * y + a[r, 2] * z + a[r, 3]
            at_b = b[r, 0] * x + b[r, 1] * y + b[r, 2] * z + b[r, 3]
            points[i, r] = (1.0 - share) * at_a + share * at_b
