"""Look-ups of recorded motion, against one sample at a time."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, strategies

from mapmyworld.geometry.planar import planar_to_matrix, wrap_angle
from mapmyworld.geometry.rigid import between, interpolate, invert, se3_exp, transform_points
from mapmyworld.kernels.recorded_motion import moved_between_knots
from mapmyworld.sensing.motion import RecordedMotion

seeds = strategies.integers(0, 2**32 - 1)


@given(seeds, strategies.floats(0.0, 3.0))
def test_poses_between_samples_are_those_of_slerp(seed: int, turn: float) -> None:
    random = np.random.default_rng(seed)
    tangents = random.normal(size=(20, 6)) * [turn, turn, turn, 5.0, 5.0, 5.0]
    poses = np.stack([se3_exp(tangent) for tangent in tangents])
    stamps = np.sort(random.integers(0, 400_000_000, 20))
    wanted = np.sort(random.integers(stamps[0] - 1000, stamps[-1] + 1000, 8))
    found = RecordedMotion(stamps, poses[:, :3]).at_many(wanted)
    assert found is not None
    for stamp, pose in zip(wanted, found, strict=True):
        after = min(np.searchsorted(stamps, stamp), 19)
        before = max(after - 1, 0) if stamps[after] > stamp else after
        share = (stamp - stamps[before]) / max(stamps[after] - stamps[before], 1)
        expected = interpolate(poses[before], poses[after], np.clip(share, 0.0, 1.0))
        np.testing.assert_allclose(pose, expected, atol=1e-9)
        np.testing.assert_allclose(pose @ invert(pose), np.eye(4), atol=1e-9)


@given(seeds)
def test_places_in_the_plane_lie_on_the_lines_between_samples(seed: int) -> None:
    random = np.random.default_rng(seed)
    rows = np.cumsum(random.normal(size=(20, 3)), axis=0)
    stamps = np.sort(random.choice(10**9, 20, replace=False))
    wanted = random.integers(stamps[0] - 10**6, stamps[-1] + 10**6, 30)
    found = RecordedMotion(stamps, planar_to_matrix(rows)[:, :3]).in_plane(wanted)
    rows[:, 2] = np.unwrap(wrap_angle(rows[:, 2]))
    expected = np.stack([np.interp(wanted, stamps, column) for column in rows.T], axis=1)
    np.testing.assert_allclose(found, expected, atol=1e-9)


def test_a_stamp_too_far_from_every_sample_has_no_pose() -> None:
    motion = RecordedMotion(np.array([0, 2 * 10**9]), np.tile(np.eye(4)[:3], (2, 1, 1)))
    near, far = np.array([0, 10**8]), np.array([0, 10**9])
    assert motion.at_many(near) is not None
    assert motion.at_many(far) is None
    assert motion.at(3 * 10**9) is None
    assert motion.at(25 * 10**8) is not None


@pytest.mark.parametrize("knots", [2, 8])
def test_beams_move_in_straight_lines_between_knots(knots: int) -> None:
    random = np.random.default_rng(knots)
    path = np.stack([se3_exp(k * random.normal(size=6) * 0.05) for k in range(knots)])
    moved = between(path[0], path)
    points, beams = random.normal(size=(50, 3)), np.arange(50)
    step = (knots - 1) / 49
    found = moved_between_knots(points, beams * step, moved)
    for i, point in enumerate(points):
        lower = min(int(i * step), knots - 2)
        share = i * step - lower
        a, b = (transform_points(moved[k], point[None])[0] for k in (lower, lower + 1))
        np.testing.assert_allclose(found[i], (1 - share) * a + share * b, atol=1e-12)
