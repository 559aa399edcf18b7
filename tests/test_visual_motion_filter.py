"""Inertia of a camera: the filter of pose and velocity, and the tracker that uses it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray
from visual_rooms import Room, circle

from mapmyworld.config import Config
from mapmyworld.geometry.rigid import between, se3_exp, se3_log
from mapmyworld.geometry.rotations import so3_exp
from mapmyworld.odometry.motion_filter import MotionFilter, motion_information
from mapmyworld.odometry.tracking_quality import TrackingQuality
from mapmyworld.odometry.visual_odometry import VisualMotion, VisualTracker
from mapmyworld.types import Frame, ImuSample

Array = NDArray[np.float64]
STEP = 0.1  # s
SHARP = np.eye(6) * 1e-6
SPEED = np.array([0.0, 0.0, 0.3, 0.5, 0.0, 0.0])  # a gentle curve


def driven(count: int) -> list[Array]:
    return [se3_exp(SPEED * STEP * k) for k in range(count)]


def started(poses: list[Array], covariance: Array) -> MotionFilter:
    """A filter that measured these poses one after the other, the first one its origin."""
    followed = MotionFilter()
    for pose in poses[1:]:
        followed.predict(STEP)
        followed.correct(pose, covariance)
    return followed


def test_a_steady_motion_is_predicted() -> None:
    poses = driven(12)
    followed = started(poses[:-1], SHARP)
    off = se3_log(between(poses[-1], followed.predict(STEP)))
    assert np.abs(off).max() < 2e-3


def test_what_images_indicate_surely_is_believed() -> None:
    poses = driven(6)
    followed = started(poses[:-1], SHARP)
    followed.predict(STEP)
    jolted = poses[-1] @ se3_exp([0.0, 0.05, 0.0, 0.0, 0.03, 0.0])
    assert np.abs(se3_log(between(jolted, followed.correct(jolted, SHARP)))).max() < 2e-3


def test_a_direction_that_images_leave_open_does_not_jump() -> None:
    """A sideways jump of 0.3 m within 0.1 s, known to 0.2 m: inertia allows a tenth of it."""
    poses = driven(8)
    followed = started(poses[:-1], SHARP)
    followed.predict(STEP)
    jumped = poses[-1] @ se3_exp([0.0, 0.0, 0.0, 0.0, 0.3, 0.0])
    open_sideways = SHARP + np.diag([0.0, 0.0, 0.0, 0.0, 0.04, 0.0])
    off = se3_log(between(poses[-1], followed.correct(jumped, open_sideways)))
    assert abs(off[4]) < 0.03
    assert not followed.slip.any()


def test_a_motion_beyond_all_expectation_is_taken_from_images_and_doubted() -> None:
    poses = driven(8)
    followed = started(poses[:-1], SHARP)
    followed.predict(STEP)
    thrown = poses[-1] @ se3_exp([0.0, 0.0, 0.0, 0.0, 0.8, 0.0])
    assert se3_log(between(thrown, followed.correct(thrown, SHARP)))[4] > -0.01
    known = motion_information(SHARP, followed.step_covariance, followed.slip)
    assert np.sqrt(np.linalg.inv(known)[4, 4]) > 0.5


def test_a_gyroscope_indicates_the_turn_better_than_constant_velocity() -> None:
    still = [np.eye(4)] * 5
    blind, turning = started(still, SHARP), started(still, SHARP)
    turned = so3_exp([0.0, 0.0, 0.4])
    blind.predict(STEP)
    assert np.allclose(turning.predict(STEP, turned)[:3, :3], turned)
    assert turning.pose_covariance()[2, 2] < 0.1 * blind.pose_covariance()[2, 2]


@settings(max_examples=40, deadline=None)
@given(
    st.lists(st.floats(-0.4, 0.4), min_size=6, max_size=6),
    st.lists(st.floats(0.001, 0.5), min_size=6, max_size=6),
    st.floats(0.0, 3.0),
)
def test_what_is_measured_is_merged_as_two_gaussians(
    off: list[float], sigmas: list[float], seconds: float
) -> None:
    """By the textbook's product of both, which the filter's gain never writes down."""
    followed = started(driven(4), SHARP)
    before = followed.predict(seconds)
    doubt, covariance = followed.pose_covariance(), np.diag(np.square(sigmas))
    followed.correct(before @ se3_exp(off), covariance)
    left = followed.pose_covariance()
    assert np.linalg.eigvalsh(left).min() > 0.0
    if not followed.slip.any():
        expected = np.linalg.inv(np.linalg.inv(doubt) + np.linalg.inv(covariance))
        assert np.allclose(left, expected, rtol=1e-4, atol=1e-10)


def test_tracked_turns_with_a_gyroscope_are_as_sure_as_the_gyroscope() -> None:
    """Blind frames know their turn where a gyroscope reported it, else they do not."""
    truth = circle((3.0, 2.5), 1.0, 8, 0.1)
    room, step_ns = Room(), 50_000_000
    frames = [
        Frame(i * step_ns, None, images=(room.image(p, i * step_ns),)) for i, p in enumerate(truth)
    ]
    dark = Frame(len(frames) * step_ns, None)
    sample = ImuSample(dark.stamp_ns, np.array([0.0, 0.0, 0.2]), np.array([0.0, 0.0, 9.81]))
    turns = []
    for last in (dark, replace(dark, imu=(sample,))):
        tracker = VisualTracker(Config())
        motion = [tracker.track(frame) for frame in [*frames, last]][-1]
        assert motion.verdict == "dead reckoning"
        turns.append(float(np.linalg.inv(motion.information)[2, 2]))
    assert turns[1] < 0.05 * turns[0]


def motion(verdict: str, *notes: str, sigma_m: float = 0.0) -> VisualMotion:
    return VisualMotion(np.eye(4), np.eye(6), verdict, notes, 0, sigma_m)


def test_blind_frames_are_reported_as_periods() -> None:
    doubts = TrackingQuality()
    for i in range(60):
        blind = i in {10, 11, 12, 15, 40}
        said = motion("dead reckoning", "no image") if blind else motion("tracked", sigma_m=0.01)
        doubts.add(i * 100_000_000, said)
    assert doubts.lines() == (
        "visual tracking lost in 5 frames (8.3%): dead reckoning",
        "lost at 1.00 s for 0.5 s (4 frames): no image",
        "lost at 4.00 s for 0.0 s (1 frames): no image",
    )


def test_only_the_longest_sections_are_named() -> None:
    doubts = TrackingQuality()
    for k in range(9):
        for i in range(k + 1):
            doubts.add((10 * k) * 1_000_000_000 + i * 100_000_000, motion("dead reckoning", "dark"))
    lines = doubts.lines()
    assert [line.split(" s ")[0] for line in lines[1:-1]] == [
        f"lost at {10 * k}.00" for k in range(4, 9)
    ]
    assert lines[-1] == "4 shorter losses of visual tracking"


def test_a_camera_that_sees_little_is_reported_and_one_that_sees_enough_is_not() -> None:
    little, enough = TrackingQuality(), TrackingQuality()
    for i in range(10):
        little.add(i, motion("tracked", sigma_m=0.2 if i < 3 else 0.01))
        enough.add(i, motion("tracked", sigma_m=0.01))
    assert enough.lines() == ()
    assert "position uncertain by more than 0.05 m in 3 frames (30.0%)" in little.lines()[0]
