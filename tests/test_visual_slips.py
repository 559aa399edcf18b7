"""Whether the base jumped, or the map beneath it."""

from __future__ import annotations

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray
from visual_rooms import Room, circle

from mapmyworld.config import Config
from mapmyworld.geometry.rigid import between, se3_exp, se3_log
from mapmyworld.odometry.visual_odometry import VisualTracker, view_of_frame
from mapmyworld.odometry.visual_slips import SteadyPath, normalised_residual, together
from mapmyworld.registration.views import View
from mapmyworld.types import Frame, ImuSample

Array = NDArray[np.float64]
INERTIA = np.diag([1e-4] * 3 + [2e-3] * 3)
IMAGES = np.diag([1e-5] * 3 + [1e-4] * 3)
SLIP = se3_exp([0.0, 0.0, 0.02, 0.3, 0.1, 0.4])


def seen_at(pose: Array) -> View:
    view = view_of_frame(Frame(0, None, images=(Room().image(pose, 0),)), Config())
    assert view is not None
    return view


def steps() -> tuple[list[Array], list[View]]:
    """A slow walk: poses in the first one's frame, and what is seen there."""
    truth = circle((3.0, 2.5), 1.0, 3, 0.08)
    return [between(truth[0], pose) for pose in truth], [seen_at(pose) for pose in truth]


def test_a_map_that_slips_does_not_carry_the_path_along() -> None:
    poses, views = steps()
    path = SteadyPath(Config())
    path.reach(poses[0], views[0])
    guess = poses[1] @ se3_exp([0.0, 0.0, 0.0, 0.02, 0.0, 0.0])
    known = path.undo_slip(views[1], (SLIP @ poses[1], IMAGES), (guess, INERTIA))
    assert known is not None
    assert np.linalg.eigvalsh(known)[-1] < np.linalg.eigvalsh(INERTIA)[-1]
    assert np.abs(se3_log(between(poses[1], path.reach(SLIP @ poses[1], views[1])))).max() < 0.01
    after = path.reach(SLIP @ poses[2], views[2])
    assert np.abs(se3_log(between(poses[2], after))).max() < 0.01


def test_a_jolt_is_followed() -> None:
    """By inertia the camera stands still; by the map and the last two images it moved."""
    poses, views = steps()
    path = SteadyPath(Config())
    path.reach(poses[0], views[0])
    still = poses[0], 1e-2 * INERTIA
    assert path.undo_slip(views[2], (poses[2], IMAGES), still) is None
    assert np.array_equal(path.reach(poses[2], views[2]), poses[2])


def test_without_an_image_before_nothing_is_undone() -> None:
    poses, views = steps()
    path = SteadyPath(Config())
    path.reach(poses[0], None)
    assert path.undo_slip(views[1], (SLIP @ poses[1], IMAGES), (poses[1], INERTIA)) is None


numbers = st.lists(st.floats(-0.2, 0.2), min_size=6, max_size=6)


@settings(max_examples=40, deadline=None)
@given(numbers, numbers, st.floats(0.1, 10.0))
def test_two_measurements_together_lie_between_and_are_surer(
    first: list[float], off: list[float], share: float
) -> None:
    one = se3_exp(np.array(first)), INERTIA
    other = one[0] @ se3_exp(0.2 * np.array(off)), share * INERTIA
    both, covariance = together(one, other)
    assert np.allclose(se3_log(between(one[0], both)), 0.2 * np.array(off) / (1.0 + share))
    assert np.allclose(np.linalg.inv(covariance), np.linalg.inv(one[1]) + np.linalg.inv(other[1]))
    assert normalised_residual(one, (both, covariance)) <= normalised_residual(one, other) + 1e-9


def test_a_picture_recognised_where_the_camera_cannot_be_is_not_believed() -> None:
    """Standing still by the gyroscope, a hand before the lens, then the view from 0.2 rad aside."""
    here, aside = (circle((3.0, 2.5), 0.0, 1, 0.0, phase=phase)[0] for phase in (0.0, 0.2))
    still = (ImuSample(0, np.zeros(3), np.array([0.0, 0.0, 9.81]), None),)
    tracker = VisualTracker(Config())
    for k in range(4):
        tracker.track(Frame(k * 50_000_000, None, images=(Room().image(here, 0),), imu=still))
    tracker.track(Frame(200_000_000, None, imu=still))
    seen = tracker.track(Frame(250_000_000, None, images=(Room().image(aside, 0),), imu=still))
    assert seen.verdict == "dead reckoning"
    assert "impossible place" in seen.notes[0]
    assert np.abs(se3_log(seen.tracker_from_base)).max() < 0.01
    back = tracker.track(Frame(300_000_000, None, images=(Room().image(here, 0),), imu=still))
    assert back.verdict == "tracked"
