"""A scan looked for in a submap, however poor the guess: exhaustive, by branch and bound."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from mapmyworld.geometry import Array
from mapmyworld.geometry.planar import between_planar
from mapmyworld.kernels.branch_and_bound import RESOLUTION, SIDE, SQUARE, best_shift
from mapmyworld.kernels.cells import judged
from mapmyworld.registration.likelihood_grid import PART, LikelihoodGrid
from mapmyworld.registration.submaps import MARGIN

Window = tuple[
    NDArray[np.uint8], NDArray[np.int8], Array, Array, Array, NDArray[np.int64], int, int, Array
]
"""What `best_shift` is given of grid, points and window."""
_WALL = 5.0 * RESOLUTION  # m around a point that show which way its wall goes
APART = 0.6, 0.3
"""Metres and radians between poses that are hypotheses of their own."""
ANOTHER = 1.0, 0.3
"""Metres and radians from which two poses in a whole map are two, and not one in doubt."""
_NOWHERE = np.array([0.0, 0.0, 0.0, -1.0, -1.0])


@dataclass(frozen=True, slots=True, eq=False)
class Found:
    """The best pose in the window and its second best."""

    pose: Array
    """(3,)."""
    score: float
    """Mean likelihood of the scan's points, 0 to 1."""
    second_best: float
    """Score of the best pose elsewhere in the window; 0 if none comes near."""
    second_best_pose: Array
    """(3,) of that pose."""


def judged_points(
    points: Array, own: LikelihoodGrid, other: LikelihoodGrid, pose: Array
) -> NDArray[np.int64]:
    """Evidence (P,) of a grid for points (P, 2): 1 hit, -1 free, 0 unseen.

    They are of their `own` grid, in its frame, which the `other` one has at `pose` (3,). What one
    saw from inside and the other one from outside are two surfaces of a wall, and so no hit.
    """
    return judged(points, own.cells, own.corner, other.cells, other.corner, pose)


def lie_on_a_line(points: Array) -> bool:
    """Whether points (N, 2) spread less than a cell across: then they are about all of one wall."""
    across = np.linalg.eigvalsh(np.cov(points.T, ddof=0))[0] if len(points) > 2 else 0.0
    return bool(across < RESOLUTION**2)


def continue_walls(points: Array, walls: Array) -> NDArray[np.bool_]:
    """(N,) whether points (N, 2) lie where a straight wall of some other points (W, 2) goes on."""
    apart = walls[:, None] - walls
    beside = np.hypot(*apart.T) < _WALL
    _, axes = np.linalg.eigh(np.einsum("ijk,ijl,ij->ikl", apart, apart, beside))
    off = np.einsum("nwk,wk->nw", points[:, None] - walls, axes[:, :, 0])
    return np.asarray((np.abs(off) < RESOLUTION).any(axis=1))


def search_evidence(
    points: Array, grid: LikelihoodGrid, guess: Array, distance: float, angle: float, least: float,
    behind: float = MARGIN,
) -> Found | None:  # fmt: skip
    """The best pose of points (N, 2) about `guess` (3,) in a grid of evidence; None below `least`.

    `least` and what a second best may be `behind` are evidence, in points.
    """
    if len(points) == 0:
        return None
    fixed = _window(points, grid, guess, distance, angle)
    a_point = 0.5 / len(fixed[2])  # of score: from a miss over nothing to a hit it is one
    floor = 0.5 + least * a_point
    best = _best(fixed, _NOWHERE, floor)
    if best is None:
        return None
    avoid, floor = np.array([*best[1:], *APART]), max(floor, best[0] - behind * a_point)
    second_best = _best(fixed, avoid, floor)
    if second_best is None:
        second_best = np.zeros(4)
    return Found(best[1:], float(best[0]), float(second_best[0]), second_best[1:])


def evidence_elsewhere(
    points: Array, grid: LikelihoodGrid, pose: Array, distance: float, angle: float, least: float,
    score: float = 0.0, behind: float = MARGIN,
) -> Array | None:  # fmt: skip
    """The best pose (3,) of points (N, 2), of more evidence than `least`.

    In a window of `distance` m and `angle` rad about `pose` (3,), but not at it; and not
    farther `behind` in evidence than a pose with this `score` elsewhere, if any.
    """
    window = _window(points, grid, pose, distance, angle)
    least = max(least, (2.0 * score - 1.0) * len(window[2]) - behind)
    return _best_of(window, np.array([*pose, *APART]), least)


def search_about(
    points: Array, grid: LikelihoodGrid, guess: Array, distance: float, angle: float, least: float
) -> Array | None:
    """The best pose (3,) of points (N, 2), if its evidence exceeds `least`.

    In a window of `distance` m and `angle` rad about `guess` (3,).
    """
    return _best_of(_window(points, grid, guess, distance, angle), _NOWHERE, least)


def search_everywhere(points: Array, grid: LikelihoodGrid, least: float) -> Array | None:
    """The best pose (3,) of points (N, 2) in a whole map, in any heading; None below `least`.

    The frame of the points lies where the map was seen. Headings are half as many as in a window,
    for the pose is looked for once more about what was found.
    """
    return _best_of(_everywhere(points, grid), _NOWHERE, least)


def search_elsewhere(
    points: Array, grid: LikelihoodGrid, pose: Array, least: float
) -> Array | None:
    """As of `search_everywhere`, a pose (3,) of points (N, 2), but not at `pose` (3,), nor in what
    continues it, as along a wall.
    """
    return _best_of(_everywhere(points, grid), np.array([*pose, *ANOTHER]), least)


def _everywhere(points: Array, grid: LikelihoodGrid) -> Window:
    step = 2.0 * _step(points)
    angles = np.arange(-np.pi, np.pi, step)
    guess = np.append(grid.corner + 0.5 * RESOLUTION, 0.0)
    reach = max(grid.pyramid.shape)
    return grid.pyramid, grid.strips, points, grid.corner, guess, grid.parts, PART, reach, angles


def _best_of(window: Window, avoid: Array, least: float) -> Array | None:
    """The best pose of more evidence, in points, than `least`."""
    best = _best(window, avoid, 0.5 + least * 0.5 / max(len(window[2]), 1))
    return None if best is None else best[1:]


def _best(window: Window, avoid: Array, least: float) -> Array | None:
    """(4,) the best score above `least`, and its pose."""
    best = np.zeros(4)
    best_shift(*window, least, avoid, best)
    return best if best[0] > least else None


def _window(
    points: Array, grid: LikelihoodGrid, guess: Array, distance: float, angle: float
) -> Window:
    """The window about a guess in which the points are looked for."""
    step = _step(points)
    count = int(np.ceil(angle / step))
    angles = np.arange(-count, count + 1, dtype=np.float64) * step
    reach = int(np.ceil(distance / RESOLUTION))
    return (
        grid.pyramid, grid.strips, points, grid.corner, guess, _blocks(reach), SIDE, reach, angles
    )  # fmt: skip


@lru_cache(64)  # most windows are of a few sizes
def _blocks(reach: int) -> NDArray[np.int64]:
    """(B, 2) lower left corners of the blocks of shifts up to `reach` cells to each side."""
    starts = np.arange(-reach, reach + 1, SIDE * SQUARE)
    return np.stack(np.meshgrid(starts, starts, indexing="ij"), axis=-1).reshape(-1, 2)


def _step(points: Array) -> float:
    """Radians by which most points move one cell."""
    far = np.sort(np.hypot(*points.T))
    far = np.interp(0.8 * (len(far) - 1), np.arange(len(far)), far)
    return float(np.clip(RESOLUTION / max(far, 1.0), 0.01, 0.05))


def are_one(pose: Array, other: Array, apart: tuple[float, float]) -> bool:
    """Whether two poses (3,) lie less than so many metres and radians `apart`."""
    off = between_planar(pose, other)
    return bool(np.hypot(*off[:2]) < apart[0] and abs(off[2]) < apart[1])
