"""A scan looked for in a submap, however poor the guess: exhaustive, by branch and bound."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property, lru_cache
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from mapmyworld.geometry import Array
from mapmyworld.geometry.planar import between_planar, transform_points_planar
from mapmyworld.kernels.branch_and_bound import RESOLUTION, SIDE, SQUARE, UNSEEN, best_shift
from mapmyworld.kernels.cells import evidence_at, first_in_cells
from mapmyworld.kernels.rays import clear_passed
from mapmyworld.registration.likelihood_grid import PART, LikelihoodGrid
from mapmyworld.registration.scan_matching import ScanSet
from mapmyworld.types import OccupancyGrid

Window = tuple[
    NDArray[np.uint8], NDArray[np.int8], Array, Array, Array, NDArray[np.int64], int, int, Array
]
"""What `best_shift` is given of grid, points and window."""
_WALL = 5.0 * RESOLUTION  # m around a point that show which way its wall goes
_BEFORE = np.stack(np.meshgrid(*2 * [np.arange(-3.0, 4.0)]), axis=-1).reshape(-1, 2)
"""Cells around a surface that reach past those beside it, (K, 2)."""
POINTS = 140
"""Of a scan or a submap that are scored, at most."""
APART = 0.6, 0.3
"""Metres and radians between poses that are hypotheses of their own."""
ANOTHER = 1.0, 0.3
"""Metres and radians from which two poses in a whole map are two, and not one in doubt."""
NATS = 0.23
"""By which a point of a submap speaks for a pose or against it: some four points count as one."""
MARGIN = float(np.log(100.0) / NATS)
"""Evidence, in points, by which a pose is a hundred times as likely as another."""
_NOWHERE = np.array([0.0, 0.0, 0.0, -1.0, -1.0])


@dataclass(frozen=True, eq=False)
class Submap:
    """What the laser saw along a section of the path, as one."""

    points: Array
    """(N, 2), scan after scan."""
    origins: Array
    """(S, 2) where each scan's lidar was."""
    bounds: NDArray[np.int64]
    """(S + 1,) where each scan's points begin; the last one ends at N."""
    size: int = 1
    """Times as long as ordinary ones."""

    @staticmethod
    def of(scans: ScanSet, poses: Array, size: int = 1) -> Submap:
        """What scans saw together at their `poses` (S, 3)."""
        origins = transform_points_planar(poses, scans.origins[:, None])[:, 0]
        return Submap(submap_points(scans, poses), origins, scans.bounds, size)

    @cached_property
    def scored(self) -> Array:
        """(P, 2) of the points, which stand for all wherever they are laid on a grid."""
        return scored_points(self.points, self.size * POINTS)

    @property
    def margin(self) -> float:
        """Evidence, in points, by which a pose must surpass others.

        What the poses within a submap err by is common to its points: so many more count as one.
        """
        return self.size * MARGIN

    @property
    def behind(self) -> float:
        """How far behind the best a second best is looked for, in points: any, in longer ones.

        These lie partly where nobody was, and what only one of two poses has seen counts little.
        """
        return MARGIN if self.size == 1 else np.inf


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


def evidence_grid(submap: Submap) -> LikelihoodGrid:
    """The grid of what scans indicate for and against a surface: 255 for, 0 against, 128 unseen."""
    low = submap.points.min(axis=0, initial=np.inf if len(submap.points) else 0.0)
    corner = low - 2.0 * RESOLUTION
    ends = np.ascontiguousarray((submap.points - corner) / RESOLUTION + SQUARE)
    cells = np.floor(ends).astype(np.int64)
    width, height = cells.max(axis=0, initial=SQUARE) + 3 + SQUARE
    edge = np.array([width, height]) - 1e-3
    starts = np.clip((submap.origins - corner) / RESOLUTION + SQUARE, 0.0, edge)
    found = np.full((height, width), UNSEEN, np.uint8)
    clear_passed(found, starts, ends, submap.bounds)
    return LikelihoodGrid.of(found, cells, corner)


def occupancy_evidence(grid: OccupancyGrid) -> tuple[Array, LikelihoodGrid]:
    """Surface points (N, 2) of an occupancy grid, and the grid of its evidence.

    A cell that is wider than those of evidence fills all that it covers.
    """
    parts = max(int(np.ceil(grid.resolution / RESOLUTION - 1e-6)), 1)
    cells = grid.trinary().repeat(parts, axis=0).repeat(parts, axis=1)
    rows, columns = np.nonzero(cells >= 0)
    middles = (np.stack([columns, rows], axis=1) + 0.5) * (grid.resolution / parts)
    at = np.floor(middles / RESOLUTION).astype(np.int64) + SQUARE + 2
    width, height = at.max(axis=0, initial=SQUARE) + 3 + SQUARE
    known = np.full((height, width), UNSEEN, np.uint8)
    is_hit = cells[rows, columns] == 100
    known[at[~is_hit, 1], at[~is_hit, 0]] = 0
    corner = np.asarray(grid.origin, np.float64) - 2.0 * RESOLUTION
    found = LikelihoodGrid.of(known, at[is_hit], corner)
    return spread_points(grid.origin + middles[is_hit], RESOLUTION), found


def judged_points(points: Array, grid: LikelihoodGrid, pose: Array) -> NDArray[np.int64]:
    """Evidence (P,) of a grid for points (P, 2) at `pose` (3,): 1 hit, -1 free, 0 unseen."""
    return np.sign(evidence_at(grid.cells, grid.corner, points, pose))


def seen_from_one_side(
    points: Array, own: LikelihoodGrid, other: LikelihoodGrid, pose: Array
) -> NDArray[np.bool_]:
    """(N,) whether beams of both grids passed before points (N, 2), which are of their `own` one.

    The other grid's frame has them at `pose` (3,). What one saw from inside and the other one from
    outside are two surfaces.
    """
    around = np.reshape(points[:, None] + RESOLUTION * _BEFORE, (-1, 2))
    seen = evidence_at(own.cells, own.corner, around, np.zeros(3)) < 0
    seen &= evidence_at(other.cells, other.corner, around, pose) < 0
    return np.asarray(seen.reshape(len(points), -1).any(axis=1))


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


def scored_points(points: Array, most: int = POINTS) -> Array:
    """Of points (N, 2) one to a cell, so that what was seen twice counts once, (P, 2); so many at
    most.
    """
    apart = spread_points(points, RESOLUTION)
    few = np.linspace(0, len(apart) - 1, min(most, len(apart))).astype(np.int64)
    return np.ascontiguousarray(apart[few], np.float64)


def spread_points(points: Array, spacing: float) -> Array:
    """The first of points (N, 2) in each cell of edge `spacing`, (K, 2)."""
    return points[first_in_cells(points, spacing)]


def submap_points(scans: ScanSet, poses: Array) -> Array:
    """All points (N, 2) of scans at their `poses` (S, 3)."""
    if len(scans) == 0:
        return np.zeros((0, 2))
    rows, of = rows_of(scans)
    c, s = np.cos(poses[:, 2])[of], np.sin(poses[:, 2])[of]
    x, y = rows[:, 0].astype(np.float64), rows[:, 1].astype(np.float64)
    return np.stack([poses[of, 0] + c * x - s * y, poses[of, 1] + s * x + c * y], axis=-1)


def rows_of(scans: ScanSet, step: int = 1) -> tuple[NDArray[np.float32], NDArray[np.int64]]:
    """Every `step`-th row (N, 5) of each scan, and which scan (N,) it is of."""
    parts = [scans.rows[a:b:step] for a, b in pairwise(scans.bounds.tolist())]
    return np.concatenate(parts), np.repeat(np.arange(len(scans)), [len(part) for part in parts])
