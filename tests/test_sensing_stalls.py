"""Odometry that stands still and catches up."""

from __future__ import annotations

import numpy as np

from mapmyworld.geometry.planar import planar_to_matrix
from mapmyworld.sensing.motion import RecordedMotion
from mapmyworld.sensing.stalls import without_stalls


def drive(stalled: slice) -> tuple[RecordedMotion, np.ndarray]:
    """A drive at 1 m/s, read every 0.1 s, whose odometry stands still for a while."""
    poses = planar_to_matrix(np.stack([0.1 * np.arange(200.0), *np.zeros((2, 200))], axis=1))
    shown = poses.copy()
    shown[stalled] = shown[stalled.start]
    stamps = 100_000_000 * np.arange(200, dtype=np.int64)
    return RecordedMotion(stamps, shown[:, :3]), poses


def test_a_stall_that_catches_up_is_interpolated() -> None:
    motion, poses = drive(slice(80, 95))
    found, count = without_stalls(motion)
    assert count == 1
    assert np.allclose(found.poses_at(slice(None)), poses, atol=1e-9)
    moved = found.shifted(10.0).followed_by(np.eye(4)).in_stamp_order()
    stamps = 10_000_000_000 + 100_000_000 * np.arange(200)
    assert np.flatnonzero([moved.is_interpolated(int(t)) for t in stamps]).tolist() == [
        *range(81, 95)
    ]
    assert moved.is_interpolated(int(stamps[80]) + 1)
    assert not motion.is_interpolated(int(stamps[85]) - 10_000_000_000)


def test_a_robot_that_stands_and_goes_on_is_left_alone() -> None:
    motion, poses = drive(slice(80, 81))
    values = np.concatenate([poses[:80], np.repeat(poses[80:81], 40, 0), poses[80:]])
    stamps = 100_000_000 * np.arange(len(values), dtype=np.int64)
    found, count = without_stalls(RecordedMotion(stamps, values[:, :3]))
    assert count == 0
    assert np.array_equal(found.poses_at(slice(None)), values)
    assert without_stalls(motion)[1] == 0
