"""What a laser sees through from where it cannot be."""

from __future__ import annotations

import numpy as np
from laser_rooms import WALLS, cast

from mapmyworld.config import Config
from mapmyworld.odometry.laser_keyframes import share_seen_through
from mapmyworld.registration.scan_matching import PreparedScan, prepare_scan, scan_set

CONFIG = Config()
FROM = np.array([-2.0, 0.0, 0.0])
TARGETS = scan_set([prepare_scan(cast(FROM, WALLS, 0), CONFIG.registration)])
HERE = prepare_scan(cast(np.array([-1.9, 0.1, 0.05]), WALLS, 1), CONFIG.registration)


def through(scan: PreparedScan, x: float, y: float, yaw: float) -> float:
    return share_seen_through(scan, TARGETS, FROM[None], np.array([x, y, yaw]))


def test_nothing_is_seen_through_walls_from_where_the_scan_was_taken() -> None:
    assert through(HERE, -1.9, 0.1, 0.05) < 0.15


def test_walls_are_seen_through_from_where_it_was_not() -> None:
    assert through(HERE, -1.1, 0.1, 0.05) > 0.5  # a metre nearer to what is ahead
    assert through(HERE, -2.7, 0.1, 0.05) < 0.5  # farther off: what is seen is nearer


def test_somebody_in_the_way_is_not_seen_through() -> None:
    rows = HERE.rows.copy()
    rows[: len(rows) // 2, :2] *= 0.3
    assert through(PreparedScan(rows, HERE.origin), -1.9, 0.1, 0.05) < 0.15


def test_without_surfaces_nothing_is_seen_through() -> None:
    blind = PreparedScan(HERE.rows[:0], HERE.origin)
    assert share_seen_through(HERE, scan_set([blind]), FROM[None], FROM) == 0.0
    assert through(blind, 0.0, 0.0, 0.0) == 0.0
