"""What a laser sees through from where it cannot be."""

from __future__ import annotations

import numpy as np
from laser_rooms import WALLS, cast

from mapmyworld.config import Config
from mapmyworld.odometry.laser_keyframes import Keyframes
from mapmyworld.registration.scan_matching import PreparedScan, prepare_scan

CONFIG = Config()
FROM = np.array([-2.0, 0.0, 0.0])
SEEN = prepare_scan(cast(FROM, WALLS, 0), CONFIG.registration)
HERE = prepare_scan(cast(np.array([-1.9, 0.1, 0.05]), WALLS, 1), CONFIG.registration)
BLIND = PreparedScan(HERE.rows[:0], HERE.origin)


def are_seen_through(
    scan: PreparedScan, x: float, y: float, yaw: float, seen: PreparedScan = SEEN
) -> bool:
    keyframes = Keyframes(CONFIG)
    keyframes.make_room(len(SEEN.rows))
    keyframes.remember(seen, FROM, 0.0)
    return keyframes.are_seen_through(scan, np.array([x, y, yaw]))


def test_walls_are_not_seen_through_from_where_the_scan_was_taken() -> None:
    assert not are_seen_through(HERE, -1.9, 0.1, 0.05)


def test_walls_are_seen_through_from_where_it_was_not() -> None:
    assert are_seen_through(HERE, -1.1, 0.1, 0.05)  # a metre nearer to what is ahead
    assert not are_seen_through(HERE, -2.7, 0.1, 0.05)  # farther off: what is seen is nearer


def test_somebody_in_the_way_sees_through_no_wall() -> None:
    rows = HERE.rows.copy()
    rows[: len(rows) // 2, :2] *= 0.3
    assert not are_seen_through(PreparedScan(rows, HERE.origin), -1.9, 0.1, 0.05)


def test_without_surfaces_nothing_is_seen_through() -> None:
    assert not are_seen_through(HERE, *FROM, seen=BLIND)
    assert not are_seen_through(BLIND, 0.0, 0.0, 0.0)
