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
from mapmyworld.odometry.laser_odometry import LaserTracker
from mapmyworld.types import Frame

_PATH = 15.0
"""Metres over which the scale may err by no more than noise does."""


def calibrated_wheels(groups: Iterable[list[Frame]], config: Config) -> Array:
    """(52,) systematic errors and noise of the odometry in the frames, which come in groups.

    Frames are tracked until the scale errs less over `_PATH` than noise does there; in a log that
    never shows its scale, that is all of it. The noise is the median over the groups, as
    that of the last motions says little of the first.
    """
    tracker, noise, count = LaserTracker(config), list[Array](), 0
    for frames in groups:
        tracker.track_all(frames)
        count += len(frames)
        noise.append(tracker.wheels[:2])
        if _PATH * tracker.wheels[16] <= float(np.median(noise, axis=0)[0]):
            break
    wheels = tracker.wheels
    if noise:
        wheels[:2] = np.median(noise, axis=0)
    decided(
        "calibrate",
        f"odometry by {count} frames: scale {wheels[2]:+.4f}, "
        f"laser {np.degrees(wheels[3]):+.2f} deg, {wheels[4]:+.3f} m, {wheels[5]:+.3f} m off, "
        f"heading {np.degrees(wheels[6]):+.2f} deg per m and {wheels[7]:+.4f} per rad",
    )
    return wheels
