"""Frames: what belongs to one moment, and sweeps with the motion taken out."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from messages_in_memory import MemoryLog, camera_info_at, image_at, odometry_at, scan_at, transform

from mapmyworld.config import SensingConfig
from mapmyworld.geometry.planar import matrix_to_planar, planar_to_matrix
from mapmyworld.sensing import make_plan, read_frames, survey_log
from mapmyworld.sensing.motion import MotionRecorder
from mapmyworld.sensing.sweeps import scan_from_message
from mapmyworld.sensing.synchronise import FrameCounts
from mapmyworld.types import Frame, Message

MS = 1_000_000
Entries = list[tuple[str, Message, int]]


def frames_of(entries: Entries, counts: FrameCounts | None = None) -> list[Frame]:
    log = MemoryLog(entries)
    plan = make_plan(survey_log(log), SensingConfig())
    return list(read_frames(log, plan, SensingConfig(), counts))


def test_every_scan_becomes_a_frame_with_odometry_of_its_stamp() -> None:
    entries: Entries = [("/tf_static", transform("base_link", "laser", (0, 0, 0)), 0)]
    entries += [
        ("/odom", odometry_at(t * MS, (t * 0.001, 0, 0)), t * MS) for t in range(0, 1000, 50)
    ]
    entries += [("/scan", scan_at(t * MS), t * MS) for t in range(20, 900, 100)]
    frames = frames_of(entries)
    assert len(frames) == 9
    for frame in frames:
        assert frame.odom_from_base is not None
        assert frame.odom_from_base[0, 3] == pytest.approx(frame.stamp_ns / MS * 0.001)


def test_an_image_goes_to_the_scan_nearest_in_time_carried_there_by_odometry() -> None:
    """The robot drives 1 m/s; the image is 30 ms younger than the scan: 3 cm ahead."""
    entries: Entries = [
        ("/tf_static", transform("base_link", "laser", (0, 0, 0)), 0),
        ("/tf_static", transform("base_link", "camera_optical", (0.1, 0, 0)), 0),
    ]
    entries += [
        ("/odom", odometry_at(t * MS, (t * 0.001, 0, 0)), t * MS) for t in range(0, 1001, 10)
    ]
    entries += [("/scan", scan_at(t * MS), t * MS) for t in range(0, 1000, 100)]
    for t in range(30, 1000, 200):
        entries += [
            ("/rgb/image", image_at(t * MS, "rgb8"), (t + 90) * MS),
            ("/depth/image", image_at((t + 5) * MS, "16UC1"), (t + 120) * MS),
            ("/rgb/camera_info", camera_info_at(t * MS), t * MS),
        ]
    frames = frames_of(entries)
    with_images = [frame for frame in frames if frame.images]
    assert [frame.stamp_ns // MS for frame in with_images] == [0, 200, 400, 600, 800]
    mount = with_images[2].images[0].camera.base_from_camera
    assert matrix_to_planar(mount) == pytest.approx([0.13, 0.0, 0.0])


@pytest.mark.parametrize("wheels", [True, False])
def test_colour_without_depth_is_counted_and_helps_only_where_images_indicate_the_motion(
    wheels: bool,
) -> None:
    entries: Entries = []
    for t in range(0, 1000, 100):
        entries.append(("/rgb/image", image_at(t * MS, "rgb8"), t * MS))
        entries.append(("/rgb/camera_info", camera_info_at(t * MS), t * MS))
        if wheels:
            entries.append(("/odom", odometry_at(t * MS, (t * 0.001, 0, 0)), t * MS))
        if t % 200 == 0:
            entries.append(("/depth/image", image_at((t + 10) * MS, "16UC1"), (t + 10) * MS))
    counts = FrameCounts()
    frames = frames_of(entries, counts)
    deep = [frame.stamp_ns // MS for frame in frames if frame.images[0].depth is not None]
    assert deep == [0, 200, 400, 600, 800]
    assert len(frames) == (5 if wheels else 10)
    assert counts.unpaired_images == 5


def test_a_sweep_taken_while_turning_comes_out_as_if_standing_still() -> None:
    """A wall of points on a circle about the odometry's origin, seen while turning at 1 rad/s."""
    recorder = MotionRecorder()
    for t in range(0, 200, 10):
        recorder.add(t * MS, planar_to_matrix([0.0, 0.0, t * 0.001]))
    beams, seconds = 181, 0.0005
    bearings = -np.pi / 2 + np.pi / 180 * np.arange(beams)
    world = bearings + seconds * np.arange(beams)
    ranges = 2.0 + np.cos(3 * world)
    scan = scan_from_message(
        scan_at(0, ranges, time_increment=seconds), np.eye(4), recorder.finish()
    )
    seen = np.hypot(scan.points[:, 0], scan.points[:, 1])
    angles = np.arctan2(scan.points[:, 1], scan.points[:, 0])
    assert np.abs(np.angle(np.exp(1j * (angles - world)))).max() < 1e-4
    assert seen == pytest.approx(2.0 + np.cos(3 * angles), abs=1e-3)


def test_invalid_ranges_are_no_points_and_only_real_misses_are_missing() -> None:
    ranges = np.full(181, 2.0)
    ranges[[0, 1, 2, 3, 4]] = [np.nan, np.inf, 0.0, 0.05, 10.0]
    scan = scan_from_message(scan_at(0, ranges), planar_to_matrix([0.5, 0.0, np.pi / 2]), None)
    assert len(scan.points) == 176
    bearings = -np.pi / 2 + np.radians([1, 2, 4]) + np.pi / 2
    assert scan.missing == pytest.approx(bearings, abs=1e-6)
    assert scan.points[85] == pytest.approx([0.5, 2.0], abs=1e-3)


@pytest.mark.filterwarnings("error")
def test_angles_beyond_single_precision_warn_nobody() -> None:
    message = replace(scan_at(0, np.full(181, 2.0)), angle_increment=3e38)
    assert len(scan_from_message(message, np.eye(4), None).points) == 181


def test_a_laser_mounted_upside_down_sees_its_bearings_mirrored() -> None:
    flipped = np.diag([1.0, -1.0, -1.0, 1.0])
    ranges = np.full(181, 2.0)
    ranges[10] = np.inf
    scan = scan_from_message(scan_at(0, ranges), flipped, None)
    assert scan.points[0] == pytest.approx([0.0, 2.0], abs=1e-6)
    assert scan.missing == pytest.approx([np.radians(80)], abs=1e-6)
