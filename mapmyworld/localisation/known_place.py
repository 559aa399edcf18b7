"""What a laser can be compared with: a finished map's grid, and scans of known places in it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import distance_transform_edt
from scipy.spatial import cKDTree

from mapmyworld.config import Config, LocalisationConfig
from mapmyworld.errors import MapError
from mapmyworld.geometry import Array
from mapmyworld.geometry.planar import matrix_to_planar, wrap_angle
from mapmyworld.kernels.map_search import cast_rays
from mapmyworld.places.whole_map import WholeMap
from mapmyworld.registration.scan_matching import (
    PreparedScan,
    ScanSet,
    prepare_scan,
    prepare_scans,
    scan_set,
)
from mapmyworld.registration.scan_search import APART
from mapmyworld.registration.submaps import occupancy_evidence
from mapmyworld.types import MapStore, OccupancyGrid, Scan

_RAYS = np.arange(-np.pi, np.pi, np.radians(1.0))


@dataclass(frozen=True, slots=True, eq=False)
class KnownPlace:
    """A map made ready for a laser."""

    resolution: float
    """Metres, edge of the grid's cells."""
    whole: WholeMap
    """For searches over the whole map."""
    scans: ScanSet
    poses: Array
    """(S, 3) of the scans."""
    tree: cKDTree

    def targets(self, pose: Array, settings: LocalisationConfig) -> NDArray[np.int64]:
        """(K,) scans taken nearest to a pose (3,), those that look the same way first."""
        near = min(6 * settings.targets, len(self.poses))
        _, found = self.tree.query(pose[:2], near)
        found = np.atleast_1d(found)
        turn = np.abs(wrap_angle(self.poses[found, 2] - pose[2]))
        apart = np.hypot(*(self.poses[found, :2] - pose[:2]).T)
        order = np.argsort(apart / settings.spacing + turn / APART[1], kind="stable")
        return np.asarray(found[order[: settings.targets]], np.int64)

    def uncertainty(self, points: Array) -> Array:
        """(3, 3) by how much all that is matched with the map errs: its cells' own width.

        Points (N, 2) of the base that are matched.
        """
        position = self.resolution**2 / 12.0  # of what lies anywhere in a cell
        return np.diag([position, position, position / np.mean(np.sum(points**2, axis=1))])


def known_place_from_store(store: MapStore, config: Config) -> KnownPlace:
    """A map of ours with a grid; its own scans are what new ones are matched with, where it has
    some.
    """
    grid = store.grid()
    assert grid is not None
    poses, scans = _spaced_scans(store, config)
    if len(scans) == 0:
        return known_place_from_grid(grid, config)
    return _known_place(grid, scans, poses)


def known_place_from_grid(grid: OccupancyGrid, config: Config) -> KnownPlace:
    """A bare grid, looked at from places all over its free cells."""
    poses, scans = _imagined_scans(grid, config)
    return _known_place(grid, scan_set(scans), poses)


def _known_place(grid: OccupancyGrid, scans: ScanSet, poses: Array) -> KnownPlace:
    if len(scans) == 0:
        raise MapError("the map's grid has no occupied cell beside a free one to localise with")
    return KnownPlace(
        grid.resolution, WholeMap(*occupancy_evidence(grid)), scans, poses, cKDTree(poses[:, :2])
    )


def _spaced_scans(store: MapStore, config: Config) -> tuple[Array, ScanSet]:
    """Scans of a map's nodes, one a place and heading, with their poses."""
    frames, final = store.tracked_frames(), store.frame_poses()
    if final is None:
        return np.zeros((0, 3)), scan_set([])
    planar = matrix_to_planar(final)
    chosen = spread_out(planar, np.flatnonzero(frames.is_node), config.localisation.spacing)
    found = dict(store.scans(chosen))
    return planar[list(found)], prepare_scans(list(found.values()), config.registration)


def spread_out(poses: Array, candidates: NDArray[np.int64], spacing: float) -> NDArray[np.int64]:
    """(K,) candidates of which no two share both a square of `spacing` and a range of headings.

    Of `candidates` (C,), indices of `poses` (N, 3); `spacing` is in metres.
    """
    cells = np.column_stack(
        [np.floor(poses[candidates, :2] / spacing), np.floor(poses[candidates, 2] / APART[1])]
    )
    return candidates[np.sort(np.unique(cells, axis=0, return_index=True)[1])]


def _imagined_scans(grid: OccupancyGrid, config: Config) -> tuple[Array, list[PreparedScan]]:
    """What a laser would see of the grid from free places on a lattice, all round."""
    cells = grid.trinary()
    occupied, known, free = cells == 100, cells >= 0, cells == 0
    clear = distance_transform_edt(free) * grid.resolution
    step = max(round(config.localisation.spacing / grid.resolution), 1)
    poses, scans = [], []
    hits = np.zeros((len(_RAYS), 2))
    range_max = config.registration.range_max
    for row in range(0, cells.shape[0], step):
        for column in range(0, cells.shape[1], step):
            spot = _clearest(clear, row, column, step)
            if spot is None:
                continue
            y, x = spot[0] + 0.5, spot[1] + 0.5
            count = cast_rays(occupied, known, x, y, _RAYS, range_max / grid.resolution, hits)
            seen = np.unique(hits[:count], axis=0)
            scan = _scan((seen - [x, y]) * grid.resolution, range_max)
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


def _scan(points: Array, range_max: float) -> Scan:
    order = np.argsort(np.arctan2(points[:, 1], points[:, 0]), kind="stable")
    increment = float(_RAYS[1] - _RAYS[0])
    sorted_points = points[order].astype(np.float32)
    nothing = np.zeros(0, np.float32)
    return Scan(sorted_points, np.zeros(3), nothing, range_max, increment)
