"""What a log teaches about its own odometry, innovation by innovation."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

from mapmyworld.geometry.planar import between_planar, compose_planar
from mapmyworld.kernels.laser_motion import innovation, robust_ratio, step_covariance
from mapmyworld.kernels.wheel_model import (
    CERTAINTY,
    MOUNT,
    NOISE,
    POSE,
    anchor,
    learn,
    new_wheels,
    reckon,
    reckoned_variances,
)

STEP = np.array([0.15, 0.0, 0.0])
SEEN = np.diag([1e6, 1e6, 1e7])  # information of a good match


def _seen(wheels: NDArray[np.float64], rotation: float) -> None:
    """One more keyframe, at which wheels report a rotation that no scan shows."""
    anchor(wheels, np.zeros(3))
    reckon(wheels, np.array([STEP[0], 0.0, rotation]))
    variances = reckoned_variances(wheels)
    learn(wheels, innovation(wheels[POSE], STEP, SEEN, variances), False)


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
        variances = reckoned_variances(wheels)
        seen = innovation(wheels[POSE], reached, SEEN, variances)
        learn(wheels, seen, False)
    assert abs(wheels[7]) < 3.0 * np.sqrt(wheels[CERTAINTY][-1])
    assert np.sqrt(wheels[CERTAINTY][-1]) < 0.025


def test_a_laser_that_is_not_where_the_log_says_is_found_by_how_it_moves() -> None:
    """9 cm ahead, 5 cm aside and turned by a degree: every turn looked like wheels at fault, and a
    match a quarter of a turn off was believed.
    """
    off = np.array([0.09, 0.05, np.radians(1.0)])
    wheels, random = new_wheels(), np.random.default_rng(4)
    for _ in range(1000):
        step = np.array([random.uniform(0.0, 0.3), 0.0, random.uniform(-0.6, 0.6)])
        reached = between_planar(off, compose_planar(step, off))
        anchor(wheels, np.zeros(3))
        reckon(wheels, step + random.normal(0.0, [0.005, 0.005, 0.005]))
        learn(wheels, innovation(wheels[POSE], reached, SEEN, reckoned_variances(wheels)), False)
    turned, ahead, aside = wheels[MOUNT]
    np.testing.assert_allclose([ahead, aside, turned], off, atol=0.006)


def test_noise_adds_up_with_the_path_and_a_wrong_scale_with_its_square() -> None:
    """Four times the way without a keyframe is twice as uncertain, not four times."""
    once, often = new_wheels(), new_wheels()
    for wheels, steps in ((once, 20), (often, 80)):
        wheels[NOISE], wheels[CERTAINTY] = 1e-3, 0.0
        for _ in range(steps):
            reckon(wheels, STEP)
    ratio = reckoned_variances(often) / reckoned_variances(once)
    np.testing.assert_allclose(ratio, 4.0, rtol=0.05)
    for wheels in (once, often):
        wheels[NOISE], wheels[CERTAINTY] = 1e-9, np.diag([1e-3, 1e-3, 0.0, 0.0, 1e-3, 0.0]).ravel()
    ratio = reckoned_variances(often) / reckoned_variances(once)
    np.testing.assert_allclose(ratio, 16.0, rtol=0.05)


def test_noise_that_is_learnt_is_what_wheels_have_however_far_keyframes_lie() -> None:
    """Wheels of 0.02 m and 0.5 degrees over a metre, seen by scans 0.5 and 2 m apart."""
    for apart in (0.5, 2.0):
        wheels, random = new_wheels(), np.random.default_rng(7)
        stated = []
        for _ in range(2000):
            reached = np.array([apart, 0.0, 0.0])
            sigmas = np.sqrt(apart) * np.array([0.02, 0.02, np.radians(0.5)])
            anchor(wheels, np.zeros(3))
            reckon(wheels, reached + random.normal(0.0, sigmas))
            variances = reckoned_variances(wheels)
            stated.append(variances / sigmas**2)
            learn(wheels, innovation(wheels[POSE], reached, SEEN, variances), False)
        np.testing.assert_allclose(np.median(stated[200:], axis=0), 1.0, rtol=0.2)


def test_noise_of_wheels_makes_their_scale_no_smaller() -> None:
    """It is in what was recorded and in what that misses: 0.04 m in 0.4 m took 1 % off."""
    wheels, random = new_wheels(), np.random.default_rng(8)
    for _ in range(4000):
        reached = np.array([0.4, 0.0, 0.0])
        anchor(wheels, np.zeros(3))
        reckon(wheels, reached + random.normal(0.0, [0.04, 0.01, 0.002]))
        learn(wheels, innovation(wheels[POSE], reached, SEEN, reckoned_variances(wheels)), False)
    assert abs(wheels[2]) < 0.005


def test_outliers_show_little_of_a_variance_and_normal_errors_all_of_it() -> None:
    """One match in ten that is off by ten sigmas made all of them eleven times as uncertain."""
    random = np.random.default_rng(5)
    two, squared = ((random.normal(size=(200_000, n)) ** 2).sum(axis=1) for n in (2, 3))
    assert np.mean([robust_ratio(s, 2) for s in two]) == pytest.approx(1.0, abs=0.01)
    assert np.mean([robust_ratio(s, 3) for s in squared]) == pytest.approx(1.0, abs=0.01)
    outliers = np.where(random.random(len(squared)) < 0.1, 300.0, squared)
    assert 1.0 < np.mean([robust_ratio(s, 3) for s in outliers]) < 1.3


def test_along_a_corridor_errors_add_up_as_those_of_odometry_and_otherwise_as_in_a_room() -> None:
    """A keyframe's way in ten steps. All of its covariance was added at every one of them."""
    sums = []
    for along in (0.1, 1e4):
        wheels, total, step = new_wheels(), np.zeros((3, 3)), np.array([0.05, 0.0, 0.0])
        before = at_first = reckoned_variances(wheels)
        for _ in range(10):
            reckon(wheels, step)
            variances = reckoned_variances(wheels)
            known = np.diag([along, 1e4, 1e5])
            total += step_covariance(step, known, variances, variances - before, 0.5, 0.5)
            before = variances
        sums.append(total.diagonal())
    corridor, room = sums
    assert corridor[0] == pytest.approx((before - at_first)[0], rel=0.02)
    assert corridor[1:] == pytest.approx(room[1:], rel=0.01)
    assert 20.0 * room[0] < corridor[0]
