"""The laser tracker: simulated drives, lying odometry, and honest notes."""

from __future__ import annotations

import itertools
from dataclasses import replace

import numpy as np
import pytest
from laser_rooms import WALLS, cast
from numpy.typing import NDArray

from mapmyworld.config import Config
from mapmyworld.geometry.planar import between_planar, compose_planar, planar_to_matrix
from mapmyworld.kernels.laser_motion import is_degenerate
from mapmyworld.odometry import laser_odometry
from mapmyworld.odometry.degeneracy import DegenerateSections
from mapmyworld.odometry.laser_keyframes import Keyframes
from mapmyworld.odometry.laser_odometry import LaserMotion, LaserTracker
from mapmyworld.odometry.pose_hypotheses import FAULT_SIZE
from mapmyworld.types import Frame, Scan


def drive(walls: NDArray[np.float64] = WALLS) -> tuple[NDArray[np.float64], list[Scan]]:
    """From one room through the door into the other, then backwards: 120 poses and scans."""
    there = np.stack(
        [np.linspace(-2, 2.2, 80), np.linspace(0, 0.4, 80), 0.4 * np.sin(np.arange(80) / 15)],
        axis=-1,
    )
    truth = np.concatenate([there, there[::-1][1:41]])
    return truth, [cast(pose, walls, seed) for seed, pose in enumerate(truth)]


def follow(
    scans: list[Scan], odometry: NDArray[np.float64] | None
) -> tuple[list[LaserMotion], LaserTracker]:
    tracker = LaserTracker(Config())
    tracked = []
    for k, scan in enumerate(scans):
        odom = None if odometry is None else planar_to_matrix(odometry[k])
        tracked.append(tracker.track(Frame(k * 100_000_000, odom, scan)))
    return tracked, tracker


def errors(tracked: list[LaserMotion], truth: NDArray[np.float64]) -> tuple[float, float]:
    """Largest error of position (m) and of yaw (rad) against the drive's first pose."""
    error = between_planar(
        between_planar(truth[0], truth), np.stack([moment.pose for moment in tracked])
    )
    return float(np.hypot(error[:, 0], error[:, 1]).max()), float(np.abs(error[:, 2]).max())


def integrate(steps: NDArray[np.float64]) -> NDArray[np.float64]:
    poses = [np.zeros(3)]
    for step in steps:
        poses.append(compose_planar(poses[-1], step))
    return np.stack(poses)


@pytest.mark.parametrize("fault", ["none", "no odometry", "forward", "stall", "jump", "scale"])
def test_tracking_survives_what_odometry_does(fault: str) -> None:
    """`forward`: counts up while the robot reverses (fr079). `stall`: stands, then catches up in
    one step (CSAIL). `jump`: 85 degrees at once. `scale`: turns counted 30 % short.
    """
    truth, scans = drive()
    steps = between_planar(truth[:-1], truth[1:])
    if fault == "forward":
        steps[79:, 0] *= -1.0
    elif fault == "stall":
        steps[30] = between_planar(truth[25], truth[31])
        steps[25:30] = 0.0
    elif fault == "jump":
        steps[50, 2] += np.radians(85.0)
    elif fault == "scale":
        steps[:, 2] *= 0.7
    tracked, _ = follow(scans, None if fault == "no odometry" else integrate(steps))
    position, yaw = errors(tracked, truth)
    assert position < 0.05
    assert yaw < 0.015
    assert all(moment.verdict not in ("lost", "odometry only") for moment in tracked)


@pytest.mark.parametrize(
    ("slip", "least", "most"),
    [((0.0, 0.5, 0.0), 0.5 * FAULT_SIZE[0], FAULT_SIZE[0] + 0.01), ((0.0, 0.0, 0.5), 0.09, 0.15)],
)
def test_where_odometry_is_ignored_the_open_direction_is_as_uncertain_as_a_fault(
    slip: tuple[float, ...], least: float, most: float
) -> None:
    """It was to be anywhere, and closures were looked for as far as they may reach.

    Of a wheel that slips the robot turns, and moves by half its track a radian.
    """
    corridor = np.array([[-99.0, -1.0, 99.0, -1.0], [-99.0, 1.0, 99.0, 1.0]])
    truth = np.stack([0.1 * np.arange(30), np.zeros(30), np.zeros(30)], axis=-1)
    steps = between_planar(truth[:-1], truth[1:])
    steps[20] += slip
    tracked, _ = follow([cast(p, corridor, k) for k, p in enumerate(truth)], integrate(steps))
    assert tracked[21].verdict == "odometry ignored"
    along = np.sqrt(np.linalg.eigvalsh(tracked[21].covariance[:2, :2])[1])
    assert least < along < most


@pytest.mark.parametrize("degrees", [20.0, 40.0, 60.0])
def test_a_wheel_that_slips_in_a_corridor_turns_no_path(degrees: float) -> None:
    """Other poses along it explain a scan as well, but where odometry has it walls are in view."""
    corridor = np.array([[-99.0, -1.0, 99.0, -1.0], [-99.0, 1.0, 99.0, 1.0]])
    truth = np.stack([0.1 * np.arange(40), np.zeros(40), np.zeros(40)], axis=-1)
    steps = between_planar(truth[:-1], truth[1:])
    steps[25, 2] += np.radians(degrees)
    tracked, _ = follow([cast(p, corridor, k) for k, p in enumerate(truth)], integrate(steps))
    metres, radians = errors(tracked, truth)
    assert metres < 0.02
    assert radians < 0.005


def test_odometry_interpolated_over_a_stall_does_not_hold_the_path() -> None:
    """The robot goes round something while its odometry stands; after that it is right again."""
    truth, _ = drive()
    truth = truth[:80:2].copy()
    bump = np.sin(np.linspace(0.0, np.pi, 11))
    truth[10:21, 1:] += np.stack([0.7 * bump, -0.9 * bump], axis=1)
    scans = [cast(pose, WALLS, seed) for seed, pose in enumerate(truth)]
    straight = truth.copy()
    straight[10:21] = np.linspace(truth[10], truth[20], 11)
    tracker, tracked = LaserTracker(Config()), []
    for k, scan in enumerate(scans):
        frame = Frame(k * 100_000_000, planar_to_matrix(straight[k]), scan)
        tracked.append(tracker.track(replace(frame, is_interpolated=10 < k < 20)))
    metres, radians = errors(tracked, truth)
    assert metres < 0.02
    assert radians < 0.01
    assert "odometry ignored" not in [motion.verdict for motion in tracked]


def test_a_corridor_after_a_gap_in_a_stall_is_not_the_one_before(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Where the robot may be metres from, walls that it would see through there refute nothing:
    it was set back 9.7 m.
    """
    monkeypatch.setattr(Keyframes, "share_seen_through", lambda *_: 1.0)
    sections = [((-12.0, y, 1.0, y), (7.0, y, 20.0, y)) for y in (-1.0, 1.0)]
    doors = [(x, y, x, 0.6 * y) for x in (-12.0, 1.0, 7.0, 20.0) for y in (-1.0, 1.0)]
    walls = np.array([*itertools.chain(*sections), *doors])
    along = np.append(np.arange(-6.0, -1.9, 0.5), 12.0)
    tracker, tracked = LaserTracker(Config()), []
    for k, x in enumerate(along):
        pose = np.array([x, 0.0, 0.0])
        frame = Frame(k * 500_000_000, planar_to_matrix(pose), cast(pose, walls, k))
        tracked.append(tracker.track(replace(frame, is_interpolated=x > 0.0)))
    assert tracked[-1].verdict == "odometry only"
    assert tracked[-1].pose[0] == pytest.approx(18.0, abs=0.1)


def test_odometry_over_a_gap_is_as_uncertain_as_the_way_that_nobody_saw() -> None:
    """Half a metre a second for 16 s, and 5 cm from where it was: it went there and back."""
    truth, scans = drive()
    blind = replace(scans[0], points=scans[0].points[:0])
    spread = []
    for seconds in (0.1, 16.0):
        tracker = LaserTracker(Config())
        for k in range(60):
            tracker.track(Frame(k * 100_000_000, planar_to_matrix(truth[k]), scans[k]))
        stamp_ns = 5_900_000_000 + round(1e9 * seconds)
        after = tracker.track(Frame(stamp_ns, planar_to_matrix(truth[60]), blind))
        assert after.verdict == "odometry only"
        spread.append(np.sqrt(after.covariance[[0, 2], [0, 2]]))
    assert (spread[1] > 10.0 * spread[0]).all()
    assert (spread[1] < 0.3).all()


def test_odometry_that_stood_while_the_robot_moved_on_counts_from_before() -> None:
    """Scans 0.6 to 0.9 m apart, two of them while it stands: then it has caught up, and is right.

    Counted from where scans placed the robot meanwhile it would lie two steps ahead.
    """
    truth = np.array([
        [-3, 0, 0], [-2.4, 0, 0], [-1.8, 0, 0], [-1.2, 0, 0.4], [-0.6, 0.3, 0.8],
        [-0.3, 1.1, 1.2], [-0.5, 1.7, 1.9], [-1, 2, 2.4],
    ], np.float64)  # fmt: skip
    steps = between_planar(truth[:-1], truth[1:])
    steps[4] = between_planar(truth[2], truth[5])
    steps[2:4] = 0.0
    tracked, _ = follow([cast(p, WALLS, k) for k, p in enumerate(truth)], integrate(steps))
    ignored = [moment.verdict == "odometry ignored" for moment in tracked]
    assert ignored == [False, False, False, True, True, False, False, False]
    metres, radians = errors(tracked, truth)
    assert metres < 0.02
    assert radians < 0.01


@pytest.mark.parametrize("step", [0.07, 0.1, 0.15])
def test_a_match_that_explains_far_less_than_those_before_is_no_match(step: float) -> None:
    """Back and forth past a niche, which odometry counts as forwards: the walls fit all along."""
    corners = [(0, 0), (5, 0), (5, -0.6), (5.8, -0.6), (5.8, 0), (9, 0), (9, 2), (0, 2), (0, 0)]
    walls = np.array([[*a, *b] for a, b in itertools.pairwise(corners)], np.float64)
    there, back = np.arange(1.5, 4.5, step), np.arange(4.5, 3.0, -step)
    x = np.concatenate([there, back, np.arange(3.0, 4.5, step)])
    truth = np.stack([x, np.ones(len(x)), np.zeros(len(x))], axis=-1)
    odometry = np.zeros_like(truth)
    odometry[1:, 0] = np.abs(np.diff(x)).cumsum()
    tracked, _ = follow([cast(pose, walls, seed) for seed, pose in enumerate(truth)], odometry)
    metres, radians = errors(tracked, truth)
    assert metres < 0.02
    assert radians < 0.01


def test_lying_odometry_is_noted() -> None:
    truth, scans = drive()
    steps = between_planar(truth[:-1], truth[1:])
    steps[50, 2] += np.radians(85.0)
    _, tracker = follow(scans, integrate(steps))
    assert any("jumps" in note for note in tracker.notes())


def test_a_blinded_laser_leaves_it_to_the_odometry() -> None:
    truth, scans = drive()
    empty = Scan(np.zeros((0, 2), np.float32), np.zeros(3), np.zeros(0, np.float32), 8.0, 0.01)
    scans[40:50] = [empty] * 10
    odometry = integrate(between_planar(truth[:-1], truth[1:]))
    tracked, tracker = follow(scans, odometry)
    assert {moment.verdict for moment in tracked[40:50]} == {"odometry only"}
    assert errors(tracked, truth)[0] < 0.1
    assert any("could not be matched" in note for note in tracker.notes())
    seen, blind = tracked[30].covariance, tracked[45].covariance
    assert np.linalg.det(blind) > np.linalg.det(seen)


@pytest.mark.parametrize("empty", [1, 5])
def test_scans_that_begin_empty_are_tracked_from_the_first_that_is_not(empty: int) -> None:
    """A laser that still starts up; the odometry's turns are 30 % short."""
    truth, scans = drive()
    nothing = np.zeros((0, 2), np.float32)
    scans[:empty] = [Scan(nothing, np.zeros(3), np.zeros(0, np.float32), 0.0, 0.0)] * empty
    steps = between_planar(truth[:-1], truth[1:])
    steps[empty:, 2] *= 0.7
    tracked, _ = follow(scans, integrate(steps))
    verdicts = [motion.verdict for motion in tracked]
    assert verdicts.count("odometry only") == empty  # the first with points among them
    far, turned = errors(tracked, truth)
    assert far < 0.03
    assert turned < 0.01


def test_a_laser_that_indicates_nothing_of_most_of_the_drive_is_a_loss() -> None:
    """Ranges in millimetres: all lie beyond what is matched."""
    truth, scans = drive()
    sound = follow(scans, truth)[1]
    assert sound.losses() == ()
    far = [replace(scan, points=scan.points * 1000) for scan in scans]
    lost = follow(far, truth)[1].losses()
    assert len(lost) == 1
    assert f"{len(scans) - 1} of {len(scans)} scans match nothing" in lost[0]


def test_a_corridor_is_reported_with_its_section() -> None:
    """Only walls along x: along x the motion is the odometry's, and its uncertainty grows."""
    walls = np.array([[-99.0, -1.0, 99.0, -1.0], [-99.0, 1.0, 99.0, 1.0]])
    truth = np.stack([np.linspace(0, 6, 100), np.zeros(100), np.zeros(100)], axis=-1)
    scans = [cast(pose, walls, seed) for seed, pose in enumerate(truth)]
    tracked, tracker = follow(scans, truth)
    along = sum(moment.covariance[0, 0] for moment in tracked[1:])
    across = sum(moment.covariance[1, 1] for moment in tracked[1:])
    assert along > 20.0 * across
    assert abs(tracked[-1].pose[0] - 6.0) < 3.0 * np.sqrt(along)
    assert any("position along it relies on odometry" in note for note in tracker.notes())


def test_weak_sections_are_bridged_and_measured() -> None:
    weak, good = np.diag([1.0, 1e5, 1e5]), np.diag([1e5, 1e5, 1e5])
    assert is_degenerate(weak)
    assert not is_degenerate(good)
    sections = DegenerateSections()
    for k in range(60):
        open_now = 10 <= k < 40 and k != 20
        sections.add(k * 10**9, 0.1, weak=is_degenerate(weak if open_now else good))
    (note,) = sections.notes()
    assert note.startswith("degenerate from 10 s to 39 s (2.9 m, corridor)")


def test_scans_followed_together_are_followed_as_one_by_one() -> None:
    """With a blind section and a jump of the odometry, which leave the kernel, in between."""
    truth, scans = drive()
    nothing = np.zeros((0, 2), np.float32)
    scans[40:43] = [Scan(nothing, np.zeros(3), scans[0].missing, 8.0, 0.01)] * 3
    steps = between_planar(truth[:-1], truth[1:])
    steps[60, 2] += np.radians(85.0)
    odometry = planar_to_matrix(integrate(steps))
    frames = [Frame(k, odometry[k], scan) for k, scan in enumerate(scans)]
    single, together = LaserTracker(Config()), LaserTracker(Config())
    one_by_one = [single.track(frame) for frame in frames]
    at_once = [*together.track_all(frames[:33]), *together.track_all(frames[33:])]
    for a, b in zip(one_by_one, at_once, strict=True):
        assert a.verdict == b.verdict
        np.testing.assert_array_equal(a.pose, b.pose)
        np.testing.assert_array_equal(a.covariance, b.covariance)
    assert single.notes() == together.notes()
    assert sum(moment.overlap > 0.5 for moment in at_once) > 0.8 * len(scans)


def test_scans_that_the_kernel_leaves_are_tracked_the_same(monkeypatch: pytest.MonkeyPatch) -> None:
    """Here it leaves all of them."""
    truth, scans = drive()
    odometry = planar_to_matrix(integrate(between_planar(truth[:-1], truth[1:])))
    frames = [Frame(k, odometry[k], scan) for k, scan in enumerate(scans)]
    expected = LaserTracker(Config()).track_all(frames)
    monkeypatch.setattr(laser_odometry, "track_scans", lambda first, *_: first)
    for a, b in zip(LaserTracker(Config()).track_all(frames), expected, strict=True):
        assert a.verdict == b.verdict
        np.testing.assert_allclose(a.pose, b.pose, atol=1e-9)
        np.testing.assert_allclose(a.covariance, b.covariance, rtol=1e-6, atol=1e-12)


def corridor_of_doors() -> NDArray[np.float64]:
    """Walls 2 m apart, in which doors lie 10 cm deep, every 4 m on one side or the other."""
    walls: list[list[float]] = []
    for side, doors in ((-1.0, (5.0, 13.0, 21.0)), (1.0, (9.0, 17.0, 25.0))):
        at = -20.0
        for x in doors:
            deep = 1.1 * side
            walls += [[at, side, x, side], [x, side, x, deep], [x, deep, x + 0.9, deep],
                      [x + 0.9, deep, x + 0.9, side]]  # fmt: skip
            at = x + 0.9
        walls.append([at, side, 60.0, side])
    walls += [[-2.0, -0.5, -1.6, -0.5], [-1.6, -0.5, -1.6, -0.9]]
    return np.array([*walls, [2.0, 0.5, 2.4, 0.5], [2.4, 0.5, 2.4, 0.9]])


def test_without_odometry_a_robot_goes_on_as_its_log_shows_that_it_does() -> None:
    """Steps were expected to change by all of their length: at some door the robot stood still."""
    along = 0.07 * np.arange(300)
    truth = np.stack([along, 0.02 * np.sin(along), 0.02 * np.cos(along)], axis=-1)
    walls, missed = corridor_of_doors(), []
    for seed in range(6):
        tracked, _ = follow([cast(p, walls, 1000 * seed + k) for k, p in enumerate(truth)], None)
        missed.append(tracked[-1].pose[0] - along[-1])
    assert np.sqrt(np.mean(np.square(missed))) < 0.45  # of 21 m; 0.9 m
