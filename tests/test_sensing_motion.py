"""Recorded motion: look-ups by stamp, in sorted and in scrambled logs."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from mapmyworld.geometry.planar import matrix_to_planar, planar_to_matrix
from mapmyworld.sensing.motion import MotionRecorder, RecordedMotion


def recorded(samples: list[tuple[int, tuple[float, float, float]]]) -> RecordedMotion:
    recorder = MotionRecorder()
    for stamp_ns, pose in samples:
        recorder.add(stamp_ns, planar_to_matrix(pose))
    return recorder.finish()


@given(st.integers(0, 1000))
def test_straight_motion_is_interpolated_exactly(stamp_ns: int) -> None:
    motion = recorded([(0, (0.0, 0.0, 0.0)), (400, (0.4, 0.0, 0.2)), (1000, (1.0, 0.0, 0.5))])
    pose = motion.at(stamp_ns)
    assert pose is not None
    assert matrix_to_planar(pose) == pytest.approx([stamp_ns / 1000, 0.0, stamp_ns / 2000])


def test_turning_goes_the_shorter_way() -> None:
    motion = recorded([(0, (0.0, 0.0, 3.0)), (10, (0.0, 0.0, -3.0))])
    pose = motion.at(5)
    assert pose is not None
    assert abs(matrix_to_planar(pose)[2]) == pytest.approx(np.pi)


def test_far_outside_the_record_there_is_no_pose() -> None:
    motion = recorded([(0, (0.0, 0.0, 0.0)), (10, (1.0, 0.0, 0.0))])
    assert motion.at(500_000_011) is None
    inside = motion.at(500_000_010)
    assert inside is not None
    assert inside[0, 3] == pytest.approx(1.0)


def test_where_stamps_step_back_the_order_of_the_log_is_the_order_of_motion() -> None:
    """Two samples share a stamp, far apart in the log: each look-up takes the one near the last."""
    samples = [(10 * i, (float(i), 0.0, 0.0)) for i in range(300)]
    samples[200] = (500, (200.0, 0.0, 0.0))
    motion = recorded(samples)
    assert not motion.is_sorted
    for stamp_ns, (x, _, _) in samples:
        pose = motion.at(stamp_ns)
        assert pose is not None
        assert pose[0, 3] == pytest.approx(x)


@given(st.lists(st.integers(0, 30), min_size=1, max_size=40), st.lists(st.integers(-5, 35)))
def test_samples_of_a_stamp_are_found_as_by_looking_at_all(
    stamps: list[int], wanted: list[int]
) -> None:
    motion = recorded([(stamp, (float(i), 0.0, 0.0)) for i, stamp in enumerate(stamps)])
    for stamp in wanted:
        expected = [i for i, found in enumerate(stamps) if found == stamp]
        assert motion._samples_at(stamp).tolist() == expected


def test_a_fixed_offset_is_carried_along() -> None:
    motion = recorded([(0, (1.0, 2.0, np.pi / 2))])
    moved = motion.followed_by(planar_to_matrix([0.5, 0.0, 0.0])).at(0)
    assert moved is not None
    assert matrix_to_planar(moved) == pytest.approx([1.0, 2.5, np.pi / 2])
