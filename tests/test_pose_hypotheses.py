"""What becomes of a match that was found without the odometry."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from mapmyworld.config import OdometryConfig
from mapmyworld.odometry.pose_hypotheses import FAULT, FAULT_SIZE, Prior
from mapmyworld.registration.scan_matching import Match

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
