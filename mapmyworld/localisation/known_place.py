"""What a laser can be compared with: a finished map's grid, and scans of known places in it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import distance_transform_edt
from scipy.spatial import cKDTree

from mapmyworld.config import Config
from mapmyworld.errors import MapError
from mapmyworld.geometry.planar import matrix_to_planar, transform_points_planar, wrap_angle
from mapmyworld.kernels.map_search import cast_rays, explain_points
from mapmyworld.places.whole_map import WholeMap, map_of_grid
from mapmyworld.registration.scan_matching import PreparedScan, ScanSet, prepare_scan, scan_set
from mapmyworld.types import MapStore, OccupancyGrid, Scan

Array = NDArray[np.float64]
_FARTHEST = 1.0  # m from a surface beyond which the distance no longer matters
_SPOTS = 1.0  # m between the places from which a bare grid is looked at
_RAYS = np.arange(-np.pi, np.pi, np.radians(1.0))
_RAY_REACH = 20.0  # m
_METRES_PER_RADIAN = 1.0  # how much farther a scan counts for looking elsewhere
_TURNED = 0.6  # rad of difference in heading from which a scan at the same place is kept as well


@dataclass(frozen=True, slots=True)
class Fit:
    """How a scan goes with the map."""

    agreement: float
    """Share of the points that the map explains, among those of which it says something."""
    coverage: float
    """Share of all points that the map explains."""


@dataclass(frozen=True, slots=True, eq=False)
class KnownPlace:
    """A map made ready for a laser."""

    distance: NDArray[np.float32]
    """(H, W) metres from a cell to the nearest occupied one, `_FARTHEST` at most."""
    cells: NDArray[np.int8]
    """(H, W) 100 occupied, 0 free: where a robot can stand; -1 unknown."""
    corner: Array
    """(2,) x, y of cell (0, 0), map frame."""
    resolution: float
    whole: WholeMap
    """For searches over the whole map."""
    scans: ScanSet
    poses: Array
    """(S, 3) of the scans."""
    tree: cKDTree

    def fit(self, points: Array, origin: Array, pose: Array, limit: float) -> Fit:
        """How points (N, 2) of the base, seen from `origin` (2,) on it, go with the map.

        With the base at `pose` (3,).
        """
        counts = np.zeros(3, np.int64)
        ends = transform_points_planar(pose, points)
        eye = transform_points_planar(pose, origin[None])[0]
        explain_points(
            self.distance, self.cells, self.corner, self.resolution, ends, eye, limit, counts
        )
        explained, contradicted = int(counts[0]), int(counts[1])
        return Fit(explained / max(explained + contradicted, 1), explained / max(len(points), 1))

    def targets(self, pose: Array, count: int) -> NDArray[np.int64]:
        """(K,) scans taken nearest to a pose (3,), those that look the same way first."""
        near = min(6 * count, len(self.poses))
        _, found = self.tree.query(pose[:2], near)
        found = np.atleast_1d(found)
        turn = np.abs(wrap_angle(self.poses[found, 2] - pose[2]))
        apart = np.hypot(*(self.poses[found, :2] - pose[:2]).T)
        order = np.argsort(apart + _METRES_PER_RADIAN * turn, kind="stable")
        return np.asarray(found[order[:count]], np.int64)


def known_place_from_store(store: MapStore, config: Config) -> KnownPlace:
    """A map of ours; its own scans are what new ones are matched with, where it has some.

    Raises `MapError` where the map has no grid.
    """
    grid = store.grid()
    if grid is None:
        raise MapError("the map has no grid: build it to its end, or give a grid's YAML file")
    poses, scans = _spaced_scans(store, config)
    if len(scans) == 0:
        return known_place_from_grid(grid, config)
    return _known_place(grid, scan_set(scans), poses)


def known_place_from_grid(grid: OccupancyGrid, config: Config) -> KnownPlace:
    """A bare grid, looked at from places all over its free cells."""
    poses, scans = _imagined_scans(grid, config)
    return _known_place(grid, scan_set(scans), poses)


def _known_place(grid: OccupancyGrid, scans: ScanSet, poses: Array) -> KnownPlace:
    cells = grid.trinary()
    occupied = cells == 100
    if not occupied.any() or len(scans) == 0:
        raise MapError("the map's grid has no occupied cell beside a free one to localise with")
    distance = distance_transform_edt(~occupied) * grid.resolution
    return KnownPlace(
        np.minimum(distance, _FARTHEST).astype(np.float32),
        cells,
        np.asarray(grid.origin, np.float64),
        grid.resolution,
        map_of_grid(grid),
        scans,
        poses,
        cKDTree(poses[:, :2]),
    )


def _spaced_scans(store: MapStore, config: Config) -> tuple[Array, list[PreparedScan]]:
    """Scans of a map's nodes, one a place and heading, with their poses."""
    frames, final = store.tracked_frames(), store.frame_poses()
    if final is None:
        return np.zeros((0, 3)), []
    planar = matrix_to_planar(final)
    chosen = spread_out(planar, np.flatnonzero(frames.is_node), config.localisation.spacing)
    found = [
        (planar[frame], prepare_scan(scan, config.registration))
        for frame, scan in store.scans(chosen)
    ]
    return np.array([pose for pose, _ in found]).reshape(-1, 3), [scan for _, scan in found]


def spread_out(poses: Array, candidates: NDArray[np.int64], spacing: float) -> NDArray[np.int64]:
    """(K,) candidates of which no two share both a square of `spacing` and a range of headings.

    Of `candidates` (C,), indices of `poses` (N, 3); `spacing` is in metres.
    """
    cells = np.column_stack(
        [np.floor(poses[candidates, :2] / spacing), np.floor(poses[candidates, 2] / _TURNED)]
    )
    return candidates[np.sort(np.unique(cells, axis=0, return_index=True)[1])]


def _imagined_scans(grid: OccupancyGrid, config: Config) -> tuple[Array, list[PreparedScan]]:
    """What a laser would see of the grid from free places on a lattice, all round."""
    cells = grid.trinary()
    occupied, known, free = cells == 100, cells >= 0, cells == 0
    clear = distance_transform_edt(free) * grid.resolution
    step = max(round(_SPOTS / grid.resolution), 1)
    poses, scans = [], []
    hits = np.zeros((len(_RAYS), 2))
    reach = _RAY_REACH / grid.resolution
    for row in range(0, cells.shape[0], step):
        for column in range(0, cells.shape[1], step):
            spot = _clearest(clear, row, column, step)
            if spot is None:
                continue
            y, x = spot[0] + 0.5, spot[1] + 0.5
            count = cast_rays(occupied, known, x, y, _RAYS, reach, hits)
            seen = np.unique(hits[:count], axis=0)
            scan = _scan((seen - [x, y]) * grid.resolution)
            prepared = prepare_scan(scan, config.registration)
            if len(prepared.rows) > 0:
                poses.append([*(grid.origin + np.array([x, y]) * grid.resolution), 0.0])
                scans.append(prepared)
    return np.array(poses).reshape(-1, 3), scans


def _clearest(clear: Array, row: int, column: int, step: int) -> tuple[int, int] | None:
    """The cell of a square that is farthest from anything; None where none is free."""
    square = clear[row : row + step, column : column + step]
    index = int(np.argmax(square))
    if square.ravel()[index] <= 0:
        return None
    return row + index // square.shape[1], column + index % square.shape[1]


def _scan(points: Array) -> Scan:
    order = np.argsort(np.arctan2(points[:, 1], points[:, 0]), kind="stable")
    increment = float(_RAYS[1] - _RAYS[0])
    sorted_points = points[order].astype(np.float32)
    nothing = np.zeros(0, np.float32)
    return Scan(sorted_points, np.zeros(3), nothing, _RAY_REACH, increment)
