"""What becomes of a match that was found without the odometry."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from laser_rooms import WALLS, cast
from numpy.typing import NDArray

from mapmyworld.config import Config, OdometryConfig
from mapmyworld.odometry.laser_keyframes import Keyframes
from mapmyworld.odometry.pose_hypotheses import FAULT, FAULT_SIZE, Prior, likeliest_match
from mapmyworld.registration.scan_matching import FINE, Match, prepare_scan

SIGMAS = np.array([0.02, 0.02, 0.01])
PRIOR = Prior(np.zeros(3), SIGMAS**2, has_odometry=True, otherwise=SIGMAS**2)


def match_at(*pose: float) -> Match:
    """As certain as the odometry."""
    return Match(np.array(pose), np.diag(SIGMAS**-2.0), 0.9, 0.01)


@pytest.mark.parametrize("pose", [(0.04, 0.0, 0.0), (0.0, -0.02, 0.03)])
def test_a_match_that_odometry_agrees_with_is_fused_with_it(pose: tuple[float, ...]) -> None:
    """Of 18 % of the clinic's key scans odometry was ignored, and was as good as the match."""
    fused, variances, is_fault = PRIOR.fused(match_at(*pose), OdometryConfig())
    np.testing.assert_allclose(fused.pose, np.array(pose) / 2.0, atol=2e-4)
    np.testing.assert_array_equal(variances, PRIOR.variances)
    assert not is_fault


def test_a_fault_leaves_the_match_alone() -> None:
    fused, variances, is_fault = PRIOR.fused(match_at(0.5, 0.3, 0.4), OdometryConfig())
    np.testing.assert_allclose(fused.pose, [0.5, 0.3, 0.4], atol=1e-3)
    np.testing.assert_array_equal(variances, FAULT_SIZE**2)
    assert is_fault


def test_where_a_wheel_slipped_odometry_still_shows_the_position() -> None:
    fused, variances, is_fault = PRIOR.fused(match_at(0.02, 0.0, 0.2), OdometryConfig())
    assert 0.0 < fused.pose[0] < 0.02
    assert fused.pose[2] == pytest.approx(0.2, abs=1e-4)
    assert 0.03 < np.sqrt(variances[0]) < 0.06
    assert is_fault


def test_wheels_that_lie_are_believed_less_where_they_lied_before() -> None:
    often = replace(PRIOR, fault=0.05)
    far = np.array([0.5, 0.3, 0.4])
    more = often.log(far, OdometryConfig()) - PRIOR.log(far, OdometryConfig())
    assert more == pytest.approx(np.log(0.05 / FAULT))
    assert often.log(np.zeros(3), OdometryConfig()) == pytest.approx(0.0, abs=1e-3)


ONE_DOOR = np.array(
    [[-20.0, -1.0, 20.0, -1.0], [-20.0, 1.0, 3.0, 1.0], [3.0, 1.0, 3.0, 1.3],
     [3.0, 1.3, 3.9, 1.3], [3.9, 1.3, 3.9, 1.0], [3.9, 1.0, 20.0, 1.0]]
)  # fmt: skip
"""A corridor, its only door 0.3 m deep."""


@pytest.mark.parametrize(("walls", "is_held"), [(ONE_DOOR, True), (WALLS, False)])
def test_a_few_points_on_a_jamb_are_no_fault_of_the_odometry(
    walls: NDArray[np.float64], is_held: bool
) -> None:
    """Odometry of 5 mm is 8 cm off what a match shows: along a corridor by one jamb alone, in a
    room by walls all round.
    """
    config, keyframes = Config(), Keyframes(Config())
    keyframes.make_room(400)
    path = np.array([[0.1 * k - 1.5, 0.0, 0.0] for k in range(11)])
    *before, scan = (
        prepare_scan(cast(p, walls, k), config.registration) for k, p in enumerate(path)
    )
    for seen, pose in zip(before, path, strict=False):
        keyframes.remember(seen, pose, 0.9)
    settings = np.array([config.registration.residual_share, 0.01, 0.3, 16.0, 0.55, 0.1, 0.1])
    first = keyframes.match(scan, path[-1], np.diag([0.04] * 3), FINE, settings)
    variances = np.square([0.005, 0.005, 0.005])
    prior = Prior(path[-1] - [0.08, 0.0, 0.0], variances, True, variances)
    state = np.array([*path[-2], 0.1, 0.0, 0.0, 0.95, 0.001])
    best = likeliest_match(scan, keyframes, state, prior, first, config.odometry, settings)
    assert best is not None
    fused, _, is_fault = prior.fused(best, config.odometry)
    ahead = fused.pose[0] - prior.pose[0]
    assert is_fault is not is_held
    assert ahead == pytest.approx(0.0 if is_held else 0.08, abs=0.005)
    assert (np.linalg.eigvalsh(best.information[:2, :2])[0] < 1.0) == is_held
