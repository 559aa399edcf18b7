"""Odometry or match: which one the tracker believes where the two are far apart."""

from __future__ import annotations

from itertools import islice
from pathlib import Path

import numpy as np
import pytest
from laser_rooms import WALLS, cast

from formats.logs import open_log
from mapmyworld.config import Config
from mapmyworld.geometry.planar import between_planar
from mapmyworld.odometry.laser import LaserTracker
from mapmyworld.registration.line_of_sight import share_seen_through
from mapmyworld.registration.scan_matching import PreparedScan, prepare_scan, scan_set
from mapmyworld.sensing import make_plan, read_frames, survey_log

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


@pytest.mark.slow
@pytest.mark.real_log
@pytest.mark.parametrize("rarely", [3, 5])
def test_wheels_that_lie_mislead_no_laser_that_sees_rarely(data: Path, rarely: int) -> None:
    """Freiburg 079 counts forward while it reverses: at a third of its rate, half a metre a scan,
    and a match of six tenths is right.
    """
    log = open_log([data / "laser" / "fr079.clf.bz2"])
    plan = make_plan(survey_log(log), CONFIG.sensing)
    frames = list(islice(read_frames(log, plan, CONFIG.sensing), 2500))
    often = LaserTracker(CONFIG).track_all(frames)[::rarely]
    tracked = LaserTracker(CONFIG).track_all(frames[::rarely])
    assert not any(moment.is_break for moment in tracked)
    steps, expected = (
        between_planar(poses[:-1], poses[1:])
        for poses in (np.stack([moment.pose for moment in some]) for some in (tracked, often))
    )
    apart = between_planar(expected, steps)
    assert np.hypot(*apart[:, :2].T).max() < 0.3  # the wheels lie by 0.65
    assert np.abs(apart[:, 2]).max() < 0.2
