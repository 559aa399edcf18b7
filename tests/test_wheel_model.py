"""What a log teaches about its own odometry, innovation by innovation."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from mapmyworld.kernels.laser_motion import innovation
from mapmyworld.kernels.wheel_model import anchor, learn, new_wheels, reckon, reckoned_variances

SHARE, FLOOR = 0.2, 0.02
STEP = np.array([0.15, 0.0, 0.0])
SEEN = np.diag([1e6, 1e6, 1e7])  # information of a good match


def _seen(wheels: NDArray[np.float64], rotation: float) -> None:
    """One more keyframe, at which wheels report a rotation that no scan shows."""
    anchor(wheels, np.zeros(3))
    reckon(wheels, np.array([STEP[0], 0.0, rotation]))
    variances = reckoned_variances(wheels, SHARE, FLOOR)
    learn(wheels, innovation(wheels[8:11], STEP, SEEN, variances), variances, SHARE)


def test_wheels_that_slip_teach_no_more_than_the_largest_error() -> None:
    """Of calm wheels 0.3 rad in 0.15 m are eleven sigmas: taught in full, the next slip looked like
    noise, and wheels that spun led the robot along a corridor.
    """
    wheels = new_wheels()
    for _ in range(40):
        _seen(wheels, 0.0)
    calm = wheels[1]
    _seen(wheels, 0.3)
    assert calm < wheels[1] < 3.0 * calm
