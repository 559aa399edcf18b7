"""How a log's odometry is calibrated before it is tracked, by as much of the log as shows it.

A tracker learns the wheels' systematic errors on the way, too late for where it began: 3 % of scale
stretch the first corridor by a metre, and no closure tells where nothing comes back. The log is
recorded, so its beginning is tracked twice.
"""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np

from mapmyworld.config import Config
from mapmyworld.decisions import decided
from mapmyworld.geometry import Array
from mapmyworld.kernels.wheel_model import CERTAINTY, FIRST_NOISE, LAST, NOISE, SYSTEMATIC
from mapmyworld.odometry.laser_odometry import LaserTracker
from mapmyworld.types import Frame

_PATH = 15.0
"""Metres over which the scale may err by no more than noise does."""


def calibrated_wheels(groups: Iterable[list[Frame]], config: Config) -> Array:
    """(56,) systematic errors and noise of the odometry in the frames, which come in groups.

    Frames are tracked until the scale errs less over `_PATH` than the noise that matches have shown
    does there; in a log that never shows its scale, that is all of it. The noise is the median over
    the groups, as that of the last motions says little of the first.
    """
    tracker, noise, shown, count = LaserTracker(config), list[Array](), list[float](), 0
    for frames in groups:
        tracker.track_all(frames)
        count += len(frames)
        wheels = tracker.wheels
        noise.append(wheels[NOISE])
        if (unknown := wheels[LAST][3]) < 0.5:  # most of it has been shown
            shown.append((wheels[NOISE][0] - unknown * FIRST_NOISE) / (1.0 - unknown))
            if _PATH * wheels[CERTAINTY][0] <= np.median(shown):
                break
    wheels = tracker.wheels
    if noise:
        wheels[NOISE] = np.median(noise, axis=0)
    scale, turned, ahead, aside, by_metre, by_radian = wheels[SYSTEMATIC].tolist()
    decided(
        "calibrate",
        f"odometry by {count} frames: scale {scale:+.4f}, "
        f"laser {np.degrees(turned):+.2f} deg, {ahead:+.3f} m, {aside:+.3f} m off, "
        f"heading {np.degrees(by_metre):+.2f} deg per m and {by_radian:+.4f} per rad",
    )
    return wheels
