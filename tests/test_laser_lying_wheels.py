"""Odometry or match: which one the tracker believes where the two are far apart."""

from __future__ import annotations

from itertools import islice
from pathlib import Path

import numpy as np
import pytest

from formats.logs import open_log
from mapmyworld.config import Config
from mapmyworld.geometry.planar import between_planar
from mapmyworld.odometry.laser_odometry import LaserTracker
from mapmyworld.sensing import make_plan, read_frames, survey_log

CONFIG = Config()


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
    assert not any(moment.verdict == "lost" for moment in tracked)
    steps, expected = (
        between_planar(poses[:-1], poses[1:])
        for poses in (np.stack([moment.pose for moment in some]) for some in (tracked, often))
    )
    apart = between_planar(expected, steps)
    assert np.hypot(*apart[:, :2].T).max() < 0.3  # the wheels lie by 0.65
    assert np.abs(apart[:, 2]).max() < 0.2
