"""Where tracking is lost nothing spans the loss: no submap, no certain motion, no shared error."""

from __future__ import annotations

import time
from collections.abc import Iterator, Sequence
from dataclasses import replace

import numpy as np
import pytest
from laser_rooms import WALLS, cast
from numpy.typing import NDArray

from mapmyworld.api import Silent
from mapmyworld.config import Config
from mapmyworld.geometry.planar import between_planar, compose_planar, planar_to_matrix
from mapmyworld.graph.frame_poses import pose_every_frame
from mapmyworld.graph.motion_chains import kept_nodes
from mapmyworld.odometry.laser_odometry import LaserMotion, LaserTracker
from mapmyworld.odometry.unobserved_motion import UnobservedMotion
from mapmyworld.places.laser_candidates import candidate_pairs
from mapmyworld.places.laser_closures import compare_places
from mapmyworld.places.laser_nodes import (
    LaserNodes,
    NodeScans,
    calm_spots,
    led_to,
    nodes_at,
)
from mapmyworld.places.laser_submaps import submap_members
from mapmyworld.places.session_closures import session_closures
from mapmyworld.registration.scan_matching import prepare_scan, scan_set
from mapmyworld.stages.nodes import Motion, NodeSelector, neighbours
from mapmyworld.stages.trackers import _follow_by_laser
from mapmyworld.types import (
    ConstraintKind,
    Frame,
    Judged,
    LaserTracking,
    Node,
    Poses,
    Scan,
    TrackedFrames,
)

CONFIG = Config()
Array = NDArray[np.float64]
NOTHING = Scan(np.zeros((0, 2), np.float32), np.zeros(3), np.zeros(0, np.float32), 8.0, 0.01)
STEP = np.array([0.05, 0.0, 0.0])
LEFT = np.stack([np.linspace(-3.0, -1.0, 41), np.full(41, 1.0), np.zeros(41)], axis=-1)
RIGHT = np.stack([np.full(41, 4.5), np.linspace(-2.0, 0.0, 41), np.full(41, np.pi / 2)], axis=-1)
CARRIED = np.concatenate([LEFT, RIGHT])  # from one room into the other, while the wheels stand


def odometry_of(truth: Array, unmoved: int | None = None) -> Array:
    """What perfect wheels indicate that were lifted at one step."""
    steps = between_planar(truth[:-1], truth[1:])
    if unmoved is not None:
        steps[unmoved - 1] = 0.0
    poses = [np.zeros(3)]
    for step in steps:
        poses.append(compose_planar(poses[-1], step))
    return np.stack(poses)


def follow(
    scans: list[Scan], odometry: Array | None, pause: tuple[int, float]
) -> tuple[list[LaserMotion], LaserTracker]:
    """`pause`: seconds without a scan before one of them."""
    tracker = LaserTracker(CONFIG)
    stamps = np.arange(len(scans)) * 100_000_000
    stamps[pause[0] :] += round(pause[1] * 1e9)
    poses = [None] * len(scans) if odometry is None else list(planar_to_matrix(odometry))
    frames = [
        Frame(int(stamp), pose, scan)
        for stamp, pose, scan in zip(stamps, poses, scans, strict=True)
    ]
    return tracker.track_all(frames), tracker


def test_a_robot_that_was_carried_off_is_lost_without_odometry_and_says_when() -> None:
    scans = [cast(pose, WALLS, k) for k, pose in enumerate(CARRIED)]
    tracked, tracker = follow(scans, None, (41, 3.0))
    assert [k for k, moment in enumerate(tracked) if moment.is_tracking_loss] == [41]
    sigmas = np.sqrt(np.diag(tracked[41].covariance))
    assert (sigmas >= 2.9).all()  # m and rad, of 3.1 s with a velocity not known yet
    assert any("tracking was lost at 7 s" in note for note in tracker.notes())
    after = np.stack([moment.pose for moment in tracked[41:]])
    error = between_planar(between_planar(RIGHT[0], RIGHT), between_planar(after[0], after))
    assert np.hypot(*error[:, :2].T).max() < 0.02  # it goes on from there as before


def test_where_odometry_goes_on_the_path_is_never_lost() -> None:
    """For 3 s no scan comes while the robot turns away: the odometry catches up in one step."""
    away = LEFT[-1] + np.array([[0.3, 0.1, 2.2], [0.3, 0.2, 2.2]])
    truth = np.concatenate([LEFT, away])
    scans = [cast(pose, WALLS, k) for k, pose in enumerate(truth)]
    tracked, tracker = follow(scans, odometry_of(truth), (41, 3.0))
    assert not any(moment.is_tracking_loss for moment in tracked)
    assert not any("lost" in note for note in tracker.notes())
    end = between_planar(between_planar(truth[0], truth[-1]), tracked[-1].pose)
    assert np.hypot(*end[:2]) < 0.05


def test_a_drive_without_losses_has_none() -> None:
    scans = [cast(pose, WALLS, k) for k, pose in enumerate(LEFT)]
    tracked, tracker = follow(scans, odometry_of(LEFT), (41, 0.0))
    assert not any(moment.is_tracking_loss for moment in tracked)
    assert not any("lost" in note for note in tracker.notes())


def test_wheels_are_trusted_less_the_farther_a_blind_robot_drove_by_them() -> None:
    """After 0.5 m unseen, 0.4 m beside where the wheels lead is no contradiction: no loss."""
    seen = [cast(pose, WALLS, k) for k, pose in enumerate(LEFT)]
    blind = [NOTHING if 20 <= k < 30 else scan for k, scan in enumerate(seen)]
    wheels = odometry_of(LEFT)
    wheels[20:30, 0] = wheels[19, 0] + 0.2 * (wheels[20:30, 0] - wheels[19, 0])
    wheels[30:, 0] -= wheels[30, 0] - wheels[29, 0] - 0.05
    tracked, _ = follow(blind, wheels, (41, 0.0))
    assert not any(moment.is_tracking_loss for moment in tracked)
    end = between_planar(between_planar(LEFT[0], LEFT[-1]), tracked[-1].pose)
    assert np.hypot(*end[:2]) < 0.03


def covered() -> Scan:
    """Something 0.3 m away all round."""
    around = np.linspace(-np.pi / 2, np.pi / 2, 181)
    points = 0.3 * np.stack([np.cos(around), np.sin(around)], axis=-1)
    times = np.zeros(181, np.float32)
    return Scan(points.astype(np.float32), np.zeros(3), times, 8.0, 0.01)


def test_what_passes_before_the_laser_loses_nothing() -> None:
    """The wheels lead on for a second, and what was seen before is there again."""
    seen = [cast(pose, WALLS, k) for k, pose in enumerate(LEFT)]
    hidden = [covered() if 20 <= k < 30 else scan for k, scan in enumerate(seen)]
    tracked, tracker = follow(hidden, odometry_of(LEFT), (41, 0.0))
    assert not any(moment.is_tracking_loss for moment in tracked)
    assert tracked[20].verdict == "odometry only"
    assert not any("lost" in note for note in tracker.notes())
    end = between_planar(between_planar(LEFT[0], LEFT[-1]), tracked[-1].pose)
    assert np.hypot(*end[:2]) < 0.02


def test_what_passes_before_the_laser_loses_nothing_without_odometry_either() -> None:
    seen = [cast(pose, WALLS, k) for k, pose in enumerate(LEFT)]
    hidden = [covered() if 20 <= k < 27 else scan for k, scan in enumerate(seen)]
    tracked, tracker = follow(hidden, None, (41, 0.0))
    assert not any(moment.is_tracking_loss for moment in tracked)
    assert [moment.verdict for moment in tracked[19:28]] == ["matched", *7 * ["lost"], "matched"]
    assert not any("lost at" in note for note in tracker.notes())
    end = between_planar(between_planar(LEFT[0], LEFT[-1]), tracked[-1].pose)
    assert np.hypot(*end[:2]) < 0.02


class Unsure:
    """A tracker that never decides."""

    def track_all(self, frames: Sequence[Frame]) -> list[LaserMotion]:
        return [LaserMotion(np.zeros(3), np.eye(3), "lost", 0.0, is_open=True) for _ in frames]


def test_a_match_with_the_submap_of_before_knows_the_way_across_a_blind_section() -> None:
    """The last motion takes no more than that: with half a turn, a hall's other end would do."""
    scans = [cast(pose, WALLS, k) for k, pose in enumerate(LEFT)]
    blind = range(15, 33)
    scans = [NOTHING if k in blind else scan for k, scan in enumerate(scans)]
    tracked, _ = follow(scans, None, (0, 0.0))
    assert not any(moment.is_tracking_loss for moment in tracked)
    assert tracked[blind.stop].verdict == "matched"
    across = sum(tracked[k].covariance for k in range(blind.start, blind.stop + 1))
    assert np.sqrt(np.diag(across)).max() < 0.3
    error = between_planar(between_planar(LEFT[0], LEFT[-1]), tracked[-1].pose)
    assert np.hypot(*error[:2]) < 0.02


def test_scans_wait_for_a_decision_in_bounded_memory() -> None:
    taken: list[int] = []

    def frames() -> Iterator[Frame]:
        for k in range(1000):
            taken.append(k)
            yield Frame(k, None, NOTHING)

    ahead = [len(taken) - done for done, _ in enumerate(_follow_by_laser(Unsure(), frames()))]  # type: ignore[arg-type]
    assert len(ahead) == 1000
    assert max(ahead) <= 128


def test_a_robot_that_stood_for_long_may_move_as_any_other() -> None:
    """Else scans of a robot that is carried off after an hour of rest would wait for as long."""
    unobserved = UnobservedMotion()
    unobserved.begin(0, np.zeros(3))
    for second in range(1, 4000):
        unobserved.take(second * 10**9, np.array([1e-3 * (second % 2), 0.0, 0.0]))
    assert unobserved.may_have_left(4002 * 10**9)


@pytest.mark.parametrize("days", [1.0, 20_000.0])
def test_after_days_of_silence_the_robot_may_be_anywhere_and_no_time_is_lost(days: float) -> None:
    """Or a stamp is wrong: 20,000 days lie between a clock that was never set and today."""
    scans = [cast(pose, WALLS, k) for k, pose in enumerate(LEFT)]
    begun = time.process_time()
    tracked, _ = follow(scans, None, (30, 86_400.0 * days))
    assert time.process_time() - begun < 20.0
    assert [k for k, moment in enumerate(tracked) if moment.is_tracking_loss] == [30]
    assert np.sqrt(np.diag(tracked[30].covariance)) == pytest.approx([1e3, 1e3, np.pi], rel=1e-3)


def test_after_a_minute_of_silence_a_corridor_like_the_one_before_is_no_place() -> None:
    """Where it is along the walls is open; after a moment it can be only where it was."""
    walls = np.array([[-50.0, 1.0, 50.0, 1.0], [-50.0, -1.0, 50.0, -1.0]])
    path = np.stack([np.linspace(0.0, 4.0, 81), np.zeros(81), np.zeros(81)], axis=-1)
    scans = [cast(pose, walls, k) for k, pose in enumerate(path)]
    lost = [
        [
            k
            for k, moment in enumerate(follow(scans, None, (41, pause))[0])
            if moment.is_tracking_loss
        ]
        for pause in (0.2, 60.0)
    ]
    assert lost == [[], [41]]


def neighbour(to_id: int, sigmas: Array, *, lost: bool) -> Judged:
    covariance = np.diag([1e-6, 1e-6, sigmas[2], sigmas[0], sigmas[1], 1e-6]) ** 2
    return Judged(
        to_id - 1, to_id, ConstraintKind.NEIGHBOUR, np.eye(4), np.linalg.inv(covariance),
        LaserTracking("lost" if lost else "matched", 0.0, lost),
    )  # fmt: skip


def test_what_was_lost_before_a_node_without_a_scan_was_lost_before_the_next_one() -> None:
    constraints = [
        neighbour(5, np.full(3, 1.0), lost=True),
        neighbour(6, np.full(3, 9.0), lost=False),
        neighbour(9, np.full(3, 9.0), lost=True),
        neighbour(11, np.full(3, 9.0), lost=True),
    ]
    # Node 5 has no scan: what was lost before it was lost before the next one.
    lost = led_to(
        np.array([1, 2, 3, 4, 6, 7, 8, 9]), (c for c in constraints if c.is_tracking_loss)
    )
    assert lost.tolist() == [k in (4, 7) for k in range(8)]


def two_rooms(lost: Array | None) -> LaserNodes:
    """A robot carried back to the start of its path, 2 m and 40 degrees from where it believes."""
    truth = np.concatenate([LEFT, LEFT])
    believed = truth.copy()
    shift = compose_planar(LEFT[-1], [0.0, 0.0, np.radians(40.0)])
    believed[41:] = compose_planar(shift, between_planar(LEFT[0], LEFT))
    scans = scan_set([prepare_scan(cast(p, WALLS, k), CONFIG.registration)
                      for k, p in enumerate(truth)])  # fmt: skip
    ids = np.arange(1, len(truth) + 1)
    nodes = [
        Node(int(i), 0, int(i), p, p) for i, p in zip(ids, planar_to_matrix(believed), strict=True)
    ]
    motions = [neighbour(int(k), np.full(3, 1e-8), lost=False) for k in ids[1:]]
    if lost is not None:
        motions[40] = neighbour(42, lost, lost=True)
    parted, seen = led_to(ids, (c for c in motions if c.is_tracking_loss)), np.ones(82, np.bool_)
    return nodes_at(NodeScans(nodes, scans, parted, seen, ~seen), None, None, motions)


def test_no_submap_spans_a_loss() -> None:
    broken, whole = two_rooms(np.array([5.0, 5.0, 1.5])), two_rooms(None)
    for middle in (38, 40, 41, 43):
        members = submap_members(broken, middle, CONFIG)
        assert len(set((members >= 41).tolist())) == 1
        across = submap_members(whole, middle, CONFIG)
        assert len(set((across >= 41).tolist())) == 2


def test_a_robot_carried_off_begins_a_session_that_is_joined_and_no_drift_window_reaches() -> None:
    nodes = two_rooms(np.array([5.0, 5.0, 1.5]))
    assert np.unique(nodes.session).tolist() == [0, 1]
    assert candidate_pairs(nodes, CONFIG, optimised=False) == []
    assert candidate_pairs(nodes, CONFIG, optimised=True) == []
    found = [c for c in session_closures(nodes, CONFIG, Silent(), set()) if c.accepted]
    assert found
    for c in found:
        apart = between_planar(LEFT[c.from_id - 1], LEFT[c.to_id - 42])
        error = planar_to_matrix(apart) - c.i_from_j
        assert np.abs(error).max() < 0.03


def test_a_blind_node_stands_for_no_place_and_an_empty_submap_closes_nothing() -> None:
    nodes = two_rooms(None)
    sees = np.ones(82, np.bool_)
    sees[:30] = False
    spots = calm_spots(replace(nodes, sees=sees), 1.0)
    assert len(spots)
    assert spots.min() >= 30
    blind = replace(nodes, scans=scan_set([prepare_scan(NOTHING, CONFIG.registration)] * 82))
    tried = compare_places(blind, [(0, 60), (5, 81)], CONFIG)
    assert [c.accepted for c in tried] == [False, False]


def test_a_loss_makes_a_node_at_once_and_shares_no_error() -> None:
    """Frames before it stay with their node, however far solving moves the node after it."""
    selector = NodeSelector(CONFIG.sensing, wants_images=False)
    made = []
    for k in range(4):
        pose = planar_to_matrix([0.02 * k, 0.0, 0.0])
        motion = Motion(pose, np.eye(6), LaserTracking("lost", 0.0, k == 3))
        made.append(selector.consider(Frame(k, pose), motion))
    nodes = [node for node, _, _ in made if node]
    assert [node.stamp_ns for node in nodes] == [0, 3]
    (constraint,) = neighbours([step for _, step, _ in made if step])
    assert constraint.is_tracking_loss
    frames = TrackedFrames(
        np.arange(4),
        np.array([1, 1, 1, 2]),
        np.stack([moved for _, _, moved in made]),
        np.array([True, False, False, True]),
    )
    solved = Poses(np.array([1, 2]), planar_to_matrix([[0.0, 0.0, 0.0], [5.0, 5.0, 1.0]]), None)
    every = pose_every_frame(nodes, solved, frames, [constraint])
    assert every[:3, 0, 3] == pytest.approx([0.0, 0.02, 0.04])
    assert every[:, 1, 3] == pytest.approx([0.0, 0.0, 0.0, 5.0])
    assert pose_every_frame(nodes, solved, frames)[2, 1, 3] > 1.0
    in_doubt = LaserTracking("odometry only", 0.0, doubted=True)
    for source in (in_doubt, LaserTracking("odometry ignored", 0.9)):
        motion = replace(constraint, source=source)
        np.testing.assert_array_equal(pose_every_frame(nodes, solved, frames, [motion]), every)


def test_both_ends_of_a_loss_are_kept_where_chains_are_left_out() -> None:
    nodes = [Node(k, 0, k, np.eye(4), np.eye(4)) for k in range(1, 8)]
    motions = [neighbour(k, np.full(3, 0.01), lost=k == 5) for k in range(2, 8)]
    assert kept_nodes(nodes, motions, []).tolist() == [True, False, False, True, True, False, True]
