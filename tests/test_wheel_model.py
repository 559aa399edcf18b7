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
    learn(wheels, innovation(wheels[8:11], STEP, SEEN, variances), variances, SHARE, False)


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


def test_noise_of_wheels_is_no_rotation_that_they_measure_wrong() -> None:
    """A robot drives straight 19 of 20 times, and then turns: what its wheels report meanwhile
    looked like rotations that scans deny, and 3 of 4 rad of the others were not believed.
    """
    wheels, random = new_wheels(), np.random.default_rng(3)
    for k in range(4000):
        turned = 0.3 if k % 20 == 0 else 0.0
        reached = np.array([STEP[0], 0.0, turned])
        anchor(wheels, np.zeros(3))
        reckon(wheels, reached + np.array([0.0, 0.0, random.normal(0.0, 0.03)]))
        variances = reckoned_variances(wheels, SHARE, FLOOR)
        seen = innovation(wheels[8:11], reached, SEEN, variances)
        learn(wheels, seen, variances, SHARE, False)
    assert abs(wheels[4]) < 3.0 * np.sqrt(wheels[7])
    assert np.sqrt(wheels[7]) < 0.025
