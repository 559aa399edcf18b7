"""What is said of a laser that sits elsewhere than the log says."""

from __future__ import annotations

import numpy as np

from mapmyworld.kernels.wheel_model import CERTAINTY, MOUNT, new_wheels
from mapmyworld.odometry.laser_mount import notes


def test_a_laser_that_sits_elsewhere_is_named_once_it_is_sure() -> None:
    wheels = new_wheels()
    assert not notes(wheels)
    wheels[MOUNT] = np.radians(0.5), 0.09, -0.01
    assert not notes(wheels)  # not yet
    wheels[CERTAINTY] *= 1e-2
    (note,) = notes(wheels)
    assert "+0.09 m ahead and -0.01 m to the left" in note
    assert "turned by +0.5 deg" in note


def test_a_mount_that_is_off_by_little_is_worth_no_word() -> None:
    wheels = new_wheels()
    wheels[MOUNT], wheels[CERTAINTY] = [np.radians(0.8), 0.03, 0.04], 0.0
    assert not notes(wheels)
