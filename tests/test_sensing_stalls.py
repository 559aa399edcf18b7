"""Odometry that stands still and catches up, is reset, or loses some way."""

from __future__ import annotations

import numpy as np
import pytest

from mapmyworld.geometry.planar import planar_to_matrix
from mapmyworld.geometry.rigid import between
from mapmyworld.sensing.motion import RecordedMotion
from mapmyworld.sensing.stalls import without_losses, without_resets, without_stalls


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


def test_a_short_stall_is_found_though_the_robot_is_at_times_as_fast() -> None:
    """It ends in a step of twice the usual length; one in twenty of all others is as long."""
    steps = np.where(np.arange(199) % 20 == 10, 0.2, 0.1)
    x = np.concatenate([[0.0], np.cumsum(steps)])
    poses = planar_to_matrix(np.stack([x, *np.zeros((2, 200))], axis=1))
    shown = poses.copy()
    shown[85] = shown[84]
    stamps = 100_000_000 * np.arange(200, dtype=np.int64)
    found, count = without_stalls(RecordedMotion(stamps, shown[:, :3]))
    assert count == 1
    assert np.allclose(found.poses_at(slice(None)), poses, atol=1e-9)
    assert found.is_interpolated(int(stamps[85]))


def test_a_stall_is_interpolated_whole_though_the_robot_went_slowly() -> None:
    """At its median speed it would have stood for the first two fifths of it."""
    slow = np.arange(199) % 10 < 3
    slow[80:95] = True
    x = np.concatenate([[0.0], np.cumsum(np.where(slow, 0.06, 0.1))])
    poses = planar_to_matrix(np.stack([x, *np.zeros((2, 200))], axis=1))
    shown = poses.copy()
    shown[81:95] = shown[80]
    found, count = without_stalls(RecordedMotion(100_000_000 * np.arange(200), shown[:, :3]))
    assert count == 1
    assert np.allclose(found.poses_at(slice(None)), poses, atol=1e-9)


def test_a_stall_may_have_begun_in_the_silence_before_it() -> None:
    """What follows 4 s of silence repeats a pose of 3 s before: it is no measure of then."""
    motion, poses = drive(slice(90, 131))
    kept = np.r_[:80, 121:200]
    stamps, shown = motion.stamps_ns[kept], motion.poses_at(kept)
    found, count = without_stalls(RecordedMotion(stamps, shown[:, :3]))
    assert count == 1
    assert np.allclose(found.poses_at(slice(None)), poses[kept], atol=1e-9)
    assert found.is_interpolated(int(motion.stamps_ns[121]))
    assert not found.is_interpolated(int(motion.stamps_ns[131]))


def test_a_robot_that_stands_and_goes_on_is_left_alone() -> None:
    motion, poses = drive(slice(80, 81))
    values = np.concatenate([poses[:80], np.repeat(poses[80:81], 40, 0), poses[80:]])
    stamps = 100_000_000 * np.arange(len(values), dtype=np.int64)
    found, count = without_stalls(RecordedMotion(stamps, values[:, :3]))
    assert count == 0
    assert np.array_equal(found.poses_at(slice(None)), values)
    assert without_stalls(motion)[1] == 0


def restarted(seconds: float) -> tuple[RecordedMotion, np.ndarray]:
    """A drive at 1 m/s far from the origin, where odometry begins anew after a silence."""
    poses = planar_to_matrix(np.stack([0.1 * np.arange(200.0), *np.zeros((2, 200))], axis=1))
    shown = poses.copy()
    shown[:100, 1, 3] += 500.0
    stamps = 100_000_000 * np.arange(200, dtype=np.int64)
    stamps[100:] += round(1e9 * seconds)
    return RecordedMotion(stamps, shown[:, :3]), poses


@pytest.mark.parametrize("seconds", [0.0, 3.0, 20.0])
def test_odometry_that_is_reset_is_continued(seconds: float) -> None:
    """As if the robot had stood in the step of the reset; every other step stays as it was."""
    motion, poses = restarted(seconds)
    found, count = without_resets(motion)
    steps, expected = between(*pairs(found.poses_at(slice(None)))), between(*pairs(poses))
    expected[99] = np.eye(4)
    assert count == 1
    assert np.allclose(steps, expected, atol=1e-9)
    assert found.is_interpolated(int(motion.stamps_ns[100]))


def test_a_pose_that_lies_elsewhere_for_once_is_two_resets() -> None:
    motion, poses = drive(slice(80, 81))
    poses[100, 0, 3] += 1000.0
    found, count = without_resets(RecordedMotion(motion.stamps_ns, poses[:, :3]))
    assert count == 2
    assert np.ptp(found.poses_at(slice(None))[:, 0, 3]) == pytest.approx(19.7)


def pairs(poses: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    return poses[:-1], poses[1:]


def test_a_silence_through_which_a_robot_drove_on_is_no_reset() -> None:
    motion, poses = restarted(60.0)
    poses[100:, 0, 3] += 60.0
    going_on = RecordedMotion(motion.stamps_ns, poses[:, :3])
    assert without_resets(going_on) == (going_on, 0)


def test_an_estimate_of_stalls_is_kept_beside_resets() -> None:
    motion, poses = drive(slice(80, 95))
    poses[80:95] = poses[80]
    poses[150:, 1, 3] += 500.0
    without, _ = without_stalls(RecordedMotion(motion.stamps_ns, poses[:, :3]))
    found, count = without_resets(without)
    assert count == 1
    assert found.is_interpolated(int(motion.stamps_ns[85]))


def silent(metres: float, speed: float, burst: int = 0) -> tuple[RecordedMotion, np.ndarray]:
    """A curve at 85 Hz, silent for 0.4 s; what it shows of that is so many `metres`.

    The last `burst` messages of the silence come at its end, all at once. And the true poses.
    """
    seconds = np.arange(1700) / 85.0
    moved = planar_to_matrix(np.array([[speed / 85.0, 0.0, 0.004]]))[0]
    poses = np.stack([np.linalg.matrix_power(moved, k) for k in range(1700)])
    stamps = np.round(1e9 * seconds).astype(np.int64)
    shown = poses.copy()
    at_end = planar_to_matrix(np.array([[metres, 0.0, 0.0]]))[0]
    shown[834 - burst :] = poses[800] @ at_end @ between(poses[834 - burst], poses[834 - burst :])
    stamps[834 - burst : 834] = stamps[834]
    kept = np.r_[:801, 834 - burst : 1700]
    return RecordedMotion(stamps[kept], shown[kept, :3]), poses[kept]


@pytest.mark.parametrize("burst", [0, 6])
def test_way_that_was_lost_in_a_silence_is_filled_in(burst: int) -> None:
    motion, poses = silent(0.03, 3.0, burst)
    found, count = without_losses(motion)
    assert count == 1
    assert np.allclose(found.poses_at(slice(None))[-1], poses[-1], atol=0.02)
    assert [motion.is_interpolated(int(t)) for t in found.stamps_ns] == [False] * len(poses)
    shown = np.flatnonzero([found.is_interpolated(int(t)) for t in found.stamps_ns])
    assert shown[0] == 801
    assert found.stamps_ns[shown[-1]] <= found.stamps_ns[801] + 20_000_000


def test_a_silence_through_which_way_was_counted_is_left_alone() -> None:
    motion, _ = silent(1.2, 3.0)
    assert without_losses(motion)[1] == 0


def test_a_robot_that_can_have_stopped_meanwhile_is_left_alone() -> None:
    """At half a metre per second tyres stop it, and get it going again, in a tenth of a second."""
    motion, _ = silent(0.03, 0.5)
    assert without_losses(motion)[1] == 0


def test_odometry_that_comes_in_bursts_has_no_silences() -> None:
    poses = planar_to_matrix(np.stack([0.03 * np.arange(2000.0), *np.zeros((2, 2000))], axis=1))
    stamps = (np.arange(2000, dtype=np.int64) // 200 + 1) * 2_000_000_000
    assert without_losses(RecordedMotion(stamps, poses[:, :3]))[1] == 0
