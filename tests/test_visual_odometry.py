"""The visual tracker in a room of known shape, through blindness, and on a real log."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray
from visual_rooms import Room, circle

from mapmyworld.config import Config
from mapmyworld.geometry.rigid import between, se3_log
from mapmyworld.geometry.rotations import rotation_angle
from mapmyworld.odometry.visual_odometry import VisualMotion, VisualTracker
from mapmyworld.types import Frame, ImageMessage, ImuSample, RgbdImage

Array = NDArray[np.float64]
STEP_NS = 50_000_000


def frames_of(room: Room, truth: list[Array]) -> list[Frame]:
    stamps = [i * STEP_NS for i in range(len(truth))]
    return [
        Frame(stamp, None, images=(room.image(pose, stamp),))
        for stamp, pose in zip(stamps, truth, strict=True)
    ]


def errors_of(motions: list[VisualMotion], truth: list[Array]) -> Array:
    """Distance (F,) in metres between tracked and true positions, first frames laid together."""
    found = [
        between(between(truth[0], true), motion.tracker_from_base)[:3, 3]
        for true, motion in zip(truth, motions, strict=True)
    ]
    return np.linalg.norm(found, axis=1)


def test_a_lap_in_a_room_is_followed_within_a_percent() -> None:
    truth = circle((3.0, 2.5), 1.0, 70, 0.8)
    tracker = VisualTracker(Config())
    motions = [tracker.track(frame) for frame in frames_of(Room(), truth)]
    assert motions[0].verdict == "first"
    assert {m.verdict for m in motions[1:]} == {"tracked"}
    assert errors_of(motions, truth).max() < 0.01 * 2 * np.pi * 0.8
    turn = rotation_angle(between(between(truth[0], truth[-1]), motions[-1].tracker_from_base))
    assert turn < 0.03


def test_prepared_features_give_the_same_poses_as_one_thread() -> None:
    truth = circle((3.0, 2.5), 1.0, 16, 0.15)
    frames = frames_of(Room(), truth)
    alone = VisualTracker(Config())
    expected = [alone.track(frame).tracker_from_base for frame in frames]
    ahead = VisualTracker(replace(Config(), threads=3))
    for (frame, motion), original, pose in zip(
        ahead.track_all(frames), frames, expected, strict=True
    ):
        assert frame is original
        assert np.array_equal(motion.tracker_from_base, pose)


def test_colour_without_depth_is_followed_on_known_points() -> None:
    """Every other depth image is missing, the first one too: only that frame cannot be placed."""
    truth = circle((3.0, 2.5), 1.0, 50, 0.5)
    frames = frames_of(Room(), truth)
    for i in range(0, len(frames), 2):
        flat = replace(frames[i].images[0], depth=None)
        frames[i] = replace(frames[i], images=(flat,))
    tracker = VisualTracker(Config())
    motions = [tracker.track(frame) for frame in frames]
    assert [m.verdict for m in motions[:2]] == ["dead reckoning", "first"]
    assert {m.verdict for m in motions[2:]} == {"tracked"}
    assert errors_of(motions[1:], truth[1:]).max() < 0.01 * 2 * np.pi * 0.5


def covered(image: RgbdImage) -> RgbdImage:
    """The same moment with a hand before the lens."""
    black = np.zeros((image.camera.height, image.camera.width, 3), np.uint8)
    size = (image.camera.width, image.camera.height)
    return RgbdImage(
        image.camera, ImageMessage(0, "camera", "rgb8", *size, lambda: black), image.depth
    )


def test_a_gyroscope_carries_a_turn_through_the_dark() -> None:
    """Turning on the spot at 1 rad/s; after 0.5 s of darkness the heading is still right."""
    rate = 1.0
    yaws = np.arange(30) * rate * STEP_NS * 1e-9
    truth = [circle((3.0, 2.5), 0.0, 1, 0.0, phase=float(yaw))[0] for yaw in yaws]
    frames = frames_of(Room(), truth)
    sample = np.array([0.0, 0.0, rate])
    for i in range(1, 30):
        imu = (ImuSample(i * STEP_NS, sample, np.array([0.0, 0.0, 9.81])),)
        images = (covered(frames[i].images[0]),) if 10 <= i < 20 else frames[i].images
        frames[i] = replace(frames[i], images=images, imu=imu)
    tracker = VisualTracker(Config())
    motions = [tracker.track(frame) for frame in frames]
    assert "gyroscope" in motions[19].notes[0]
    error = rotation_angle(between(between(truth[0], truth[19]), motions[19].tracker_from_base))
    assert error < 0.03
    assert motions[20].verdict == "tracked"


def test_dead_reckoning_does_not_depend_on_the_rate_of_frames() -> None:
    """A second in the dark at 5, 10 and 20 frames a second, by constant velocity alone."""
    frames = frames_of(Room(), circle((3.0, 2.5), 1.0, 41, 0.2))  # 20 a second
    for i, frame in enumerate(frames[20:], start=20):
        frames[i] = replace(frame, images=(covered(frame.images[0]),))
    ends, doubts = list[float](), list[float]()
    for every in (4, 2, 1):
        tracker = VisualTracker(Config())
        motions = [tracker.track(frame) for frame in frames[:20] + frames[20::every]]
        blind = [m for m in motions if m.verdict == "dead reckoning"]
        step = between(motions[19].tracker_from_base, motions[-1].tracker_from_base)
        ends.append(float(np.linalg.norm(step[:3, 3])))
        doubts.append(sum(float(np.linalg.inv(m.information)[3, 3]) for m in blind))
    assert ends[2] > 0.05
    assert max(ends) < 1.35 * min(ends)
    assert doubts == pytest.approx([doubts[0]] * 3, rel=0.05)


def test_a_frame_without_images_is_no_disaster() -> None:
    tracker = VisualTracker(Config())
    motion = tracker.track(Frame(0, None))
    assert motion.verdict == "dead reckoning"
    assert np.array_equal(motion.tracker_from_base, np.eye(4))


def test_a_picture_recognised_where_the_camera_cannot_be_is_not_believed() -> None:
    """Standing still by the gyroscope, a hand before the lens, then the view from 0.2 rad aside."""
    here, aside = (circle((3.0, 2.5), 0.0, 1, 0.0, phase=phase)[0] for phase in (0.0, 0.2))
    still = (ImuSample(0, np.zeros(3), np.array([0.0, 0.0, 9.81])),)
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
