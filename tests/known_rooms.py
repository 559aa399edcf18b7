"""Grids of rooms whose walls are known, and drives through them, for tests of localisation."""

from __future__ import annotations

import itertools
from collections.abc import Iterable, Iterator

import numpy as np
from laser_rooms import WALLS, cast
from numpy.typing import NDArray

from mapmyworld.config import Config
from mapmyworld.geometry.planar import between_planar, compose_planar, planar_to_matrix
from mapmyworld.mapping.occupancy import build_grid
from mapmyworld.types import Frame, OccupancyGrid

Array = NDArray[np.float64]
FRAME_NS = 100_000_000
SQUARE = np.array([[-3, -3, 3, -3], [3, -3, 3, 3], [3, 3, -3, 3], [-3, 3, -3, -3]], np.float64)


def tour(corners: Iterable[tuple[float, float]], step: float = 0.05) -> Array:
    """Poses (N, 3) along straight lines, turning on the spot by at most 0.1 rad."""
    places = np.array(list(corners))
    poses: list[list[float]] = []
    for a, b in itertools.pairwise(places):
        heading = float(np.arctan2(*(b - a)[::-1]))
        if poses:
            turn = float((heading - poses[-1][2] + np.pi) % (2 * np.pi) - np.pi)
            turned = np.sign(turn) * np.arange(0.1, abs(turn), 0.1)
            poses += [[*a, heading - turn + share] for share in turned]
        length = float(np.hypot(*(b - a)))
        poses += [[*(a + (b - a) * way / length), heading] for way in np.arange(0, length, step)]
    return np.array(poses)


def frames_of(poses: Array, walls: Array = WALLS, jumps: Iterable[int] = ()) -> Iterator[Frame]:
    """Scans along a path, with wheels that err by 2 % and feel nothing of the `jumps`."""
    odometry = np.zeros(3)
    carried = set(jumps)
    for i, pose in enumerate(poses):
        if i and i not in carried:
            odometry = compose_planar(odometry, between_planar(poses[i - 1], pose) * 1.02)
        recorded, scan = planar_to_matrix(odometry), cast(pose, walls, i)
        yield Frame(stamp_ns=(i + 1) * FRAME_NS, odom_from_base=recorded, scan=scan)


def grid_of(poses: Array, walls: Array = WALLS) -> OccupancyGrid:
    """The grid of scans at known poses."""
    scans = ((pose, cast(pose, walls, 1000 + i)) for i, pose in enumerate(poses))
    return build_grid(scans, Config())
