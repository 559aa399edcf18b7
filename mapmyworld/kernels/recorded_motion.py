"""Poses between recorded ones, and points moved along them, for every sweep of a log."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from mapmyworld.kernels.compiling import inner_jit, jit


@inner_jit
def _rotation_vector(turn: NDArray[np.float64], found: NDArray[np.float64]) -> None:
    """The rotation vector (3,), of length at most pi, of a rotation (3, 3)."""
    for k in range(3):
        i, j = (k + 1) % 3, (k + 2) % 3
        found[k] = 0.5 * (turn[j, i] - turn[i, j])
    sine = np.sqrt(found[0] ** 2 + found[1] ** 2 + found[2] ** 2)
    cosine = 0.5 * (turn[0, 0] + turn[1, 1] + turn[2, 2] - 1.0)
    angle, length = np.arctan2(sine, cosine), sine
    if cosine < -0.5:  # towards pi the sine indicates ever less of the axis: from what is symmetric
        largest = 0
        for k in range(1, 3):
            if turn[k, k] > turn[largest, largest]:
                largest = k
        sign = -1.0 if found[largest] < 0.0 else 1.0
        for k in range(3):
            found[k] = 0.5 * sign * (turn[k, largest] + turn[largest, k])
        found[largest] -= sign * cosine
        length = np.sqrt(found[0] ** 2 + found[1] ** 2 + found[2] ** 2)
    if length > 0.0:
        found *= angle / length


@inner_jit
def _turned(
    rotation: NDArray[np.float64], vector: NDArray[np.float64], found: NDArray[np.float64]
) -> None:
    """A rotation, in the first columns of (3, 4), followed by that of a rotation vector (3,), by
    Rodrigues' formula; into the first rows and columns of `found` (4, 4).
    """
    angle = np.sqrt(vector[0] ** 2 + vector[1] ** 2 + vector[2] ** 2)
    by_sine = np.sin(angle) / angle if angle > 0.0 else 1.0
    by_half = np.sin(0.5 * angle) / (0.5 * angle) if angle > 0.0 else 1.0
    by_cosine = 0.5 * by_half * by_half
    for row in range(3):
        own = rotation[row]
        along = own[0] * vector[0] + own[1] * vector[1] + own[2] * vector[2]
        for k in range(3):
            i, j = (k + 1) % 3, (k + 2) % 3
            across = own[i] * vector[j] - own[j] * vector[i]
            rest = along * vector[k] - angle * angle * own[k]
            found[row, k] = own[k] + by_sine * across + by_cosine * rest


@inner_jit
def _around(stamps: NDArray[np.int64], wanted: int) -> tuple[int, int, float]:
    """The samples at ascending `stamps` (N,) before and after one, and its share of the way on;
    outside both are those at the ends.
    """
    after = min(int(np.searchsorted(stamps, wanted)), len(stamps) - 1)
    before = max(after - 1, 0) if stamps[after] > wanted else after
    share = (wanted - stamps[before]) / max(stamps[after] - stamps[before], 1)
    return before, after, min(max(share, 0.0), 1.0)


@jit
def interpolated_poses(
    stamps: NDArray[np.int64], values: NDArray[np.float64], wanted: NDArray[np.int64],
    farthest: int, found: NDArray[np.float64],
) -> bool:  # fmt: skip
    """Whether poses at `wanted` (K,) stamps are known; then `found` (K, 4, 4) becomes these.

    Between samples `values` (N, 3, 4), at ascending `stamps` (N,), they go straight and turn by
    slerp; outside stand those at the ends. A pose is known where a sample is not `farthest` off.
    """
    vector, turn = np.zeros(3), np.zeros((3, 3))
    for k in range(len(wanted)):
        before, after, share = _around(stamps, wanted[k])
        if min(abs(wanted[k] - stamps[before]), abs(stamps[after] - wanted[k])) > farthest:
            return False
        a, b, pose = values[before], values[after], found[k]
        for i in range(3):
            for j in range(3):
                turn[i, j] = a[0, i] * b[0, j] + a[1, i] * b[1, j] + a[2, i] * b[2, j]
        _rotation_vector(turn, vector)
        for i in range(3):
            vector[i] *= share
            pose[i, 3] = (1.0 - share) * a[i, 3] + share * b[i, 3]
            pose[3, i] = 0.0
        _turned(a, vector, pose)
        pose[3, 3] = 1.0
    return True


@jit
def interpolated_rows(
    stamps: NDArray[np.int64], rows: NDArray[np.float64], wanted: NDArray[np.int64],
    found: NDArray[np.float64],
) -> None:  # fmt: skip
    """Numbers `rows` (N, K), at ascending `stamps` (N,), become `found` (M, K) at `wanted` (M,).

    They are linear between two stamps; outside stand those at the ends.
    """
    for m in range(len(wanted)):
        before, after, share = _around(stamps, wanted[m])
        for k in range(rows.shape[1]):
            found[m, k] = rows[before, k] + share * (rows[after, k] - rows[before, k])


@jit
def moved_between_knots(
    points: NDArray[np.float64], places: NDArray[np.float64], moved: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Points (N, 3) moved by the motion at their places (N,), counted in knots, (N, 3).

    `moved` (K, 4, 4) is the motion at the knots; between two they move in straight lines.
    """
    found, last = np.empty_like(points), len(moved) - 1
    for n in range(len(points)):
        place = min(max(places[n], 0.0), float(last))
        lower = min(int(place), last - 1)
        share = place - lower
        x, y, z = points[n]
        for k in range(3):
            a, b = moved[lower, k], moved[lower + 1, k]
            at_lower = a[0] * x + a[1] * y + a[2] * z + a[3]
            at_upper = b[0] * x + b[1] * y + b[2] * z + b[3]
            found[n, k] = (1.0 - share) * at_lower + share * at_upper
    return found
