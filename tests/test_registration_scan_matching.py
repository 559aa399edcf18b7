"""Scan matching: laws, analytic cases, and plain references of the kernels."""

from __future__ import annotations

import itertools
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from laser_rooms import WALLS, cast
from numpy.typing import NDArray

from mapmyworld.alignment.joint_alignment import align_in_rounds, pair_edges, without_noise
from mapmyworld.api import Silent
from mapmyworld.backend.system import System
from mapmyworld.config import Config
from mapmyworld.geometry.planar import (
    between_planar,
    compose_planar,
    invert_planar,
    planar_adjoint,
    transform_points_planar,
)
from mapmyworld.kernels.branch_and_bound import RESOLUTION, SQUARE, UNSEEN, best_shift
from mapmyworld.kernels.planar_algebra import invert3, solve3
from mapmyworld.kernels.scan_alignment import nearest
from mapmyworld.kernels.scan_pairs import pair_systems
from mapmyworld.kernels.scan_preparation import range_noise
from mapmyworld.registration.scan_matching import (
    COARSE,
    PreparedScan,
    match_scan,
    prepare_scan,
    prepare_scans,
    scan_set,
)
from mapmyworld.registration.scan_search import search_evidence
from mapmyworld.registration.submaps import Submap, evidence_grid
from mapmyworld.types import Scan

CONFIG = Config().registration
BOX = ((-4.0, -3.0), (5.0, 4.0))  # m, lower left and upper right corner of a room
CORRIDOR = ((-200.0, -1.0), (200.0, 1.0))


def room_scan(
    map_from_base: NDArray[np.float64],
    room: tuple[tuple[float, float], tuple[float, float]] = BOX,
    *,
    seed: int | None = None,
    noise: float = 0.01,
    reach: float = 20.0,
    step: float = 1.0,
) -> Scan:
    """A full turn of beams every `step` degrees in an empty rectangular room, in closed form."""
    angles = np.radians(np.arange(-180.0, 180.0, step))
    directions = np.stack([np.cos(angles + map_from_base[2]), np.sin(angles + map_from_base[2])])
    low, high = np.array(room[0]), np.array(room[1])
    with np.errstate(divide="ignore"):
        exits = np.where(
            directions.T > 0,
            (high - map_from_base[:2]) / directions.T,
            (low - map_from_base[:2]) / directions.T,
        )
    ranges = np.nanmin(np.where(np.abs(directions.T) < 1e-9, np.inf, exits), axis=1)
    if seed is not None:
        ranges = ranges + np.random.default_rng(seed).normal(size=len(ranges)) * noise
    seen = ranges < reach
    points = np.stack([ranges * np.cos(angles), ranges * np.sin(angles)], axis=-1)[seen]
    return Scan(
        points.astype(np.float32), np.zeros(3), np.zeros(0, np.float32), reach, np.radians(step)
    )


def prepared(pose: list[float], **options: object) -> PreparedScan:
    return prepare_scan(room_scan(np.array(pose), **options), CONFIG)  # type: ignore[arg-type]


def test_points_lie_on_their_walls_with_normals_towards_the_lidar() -> None:
    scan = prepared([0.5, 0.2, 0.3])
    straight = np.hypot(scan.rows[:, 2], scan.rows[:, 3]) > 0.5
    assert straight.mean() > 0.8
    assert np.all(np.diff(scan.rows[:, 4]) > 0)
    towards = np.sum(scan.rows[straight, :2] * scan.rows[straight, 2:4], axis=1)
    assert np.all(towards < 0)
    walls = transform_points_planar(np.array([0.5, 0.2, 0.3]), scan.rows[straight, :2])
    gaps = np.abs(walls[:, [0, 1, 0, 1]] - np.array([*BOX[0], *BOX[1]])).min(axis=1)
    assert gaps.max() < 0.02


def _wall_with_recesses(step: float, noise: float) -> Scan:
    """A wall 1.2 m to the left, set back by 0.1 m for every other 0.9 m, as doors are."""
    bearings = np.radians(np.arange(20.0, 160.0, step))
    ranges = 1.2 / np.sin(bearings)
    recessed = np.floor(ranges * np.cos(bearings) / 0.9) % 2 == 1
    ranges = np.where(recessed, 1.3, 1.2) / np.sin(bearings)
    ranges += np.random.default_rng(1).normal(size=len(ranges)) * noise
    points = np.stack([ranges * np.cos(bearings), ranges * np.sin(bearings)], axis=-1)
    angle = np.radians(step)
    return Scan(points.astype(np.float32), np.zeros(3), np.zeros(0, np.float32), 30.0, angle)


@pytest.mark.parametrize(("step", "noise"), [(1.0, 0.0), (1.0, 0.005), (2.7, 0.0), (2.7, 0.005)])
def test_no_line_spans_the_step_between_two_surfaces(step: float, noise: float) -> None:
    """A slanted line would stand elsewhere the nearer one looks, and stretch the corridor."""
    rows = prepare_scan(_wall_with_recesses(step, noise), CONFIG).rows
    straight = np.hypot(rows[:, 2], rows[:, 3]) > 0.5
    slants = np.degrees(np.arctan2(rows[straight, 2], -rows[straight, 3]))
    assert straight.mean() > 0.6
    assert np.sqrt(np.mean(slants**2)) < 4.0


@pytest.mark.parametrize("noise", [0.005, 0.01, 0.03, 0.05])
@pytest.mark.parametrize("step", [0.25, 1.0])
def test_the_noise_of_a_sweep_is_measured_at_any_angle_to_the_walls(
    noise: float, step: float
) -> None:
    scan = room_scan(np.array([0.5, 0.2, 0.3]), seed=2, noise=noise, step=step)
    x, y = scan.points.T.astype(np.float64)
    measured = range_noise(x, y, np.zeros(2))
    assert measured == pytest.approx(noise, rel=0.3)


def test_walls_keep_their_direction_when_ranges_are_noisier_than_points_are_apart() -> None:
    """A wall at 1 m, beams 4 mm apart, noise of 30 mm: neighbours alone indicate nothing."""
    pose = np.array([0.5, 0.0, 0.0])
    scan = room_scan(pose, CORRIDOR, seed=3, noise=0.03, step=0.25)
    rows = prepare_scan(scan, CONFIG).rows
    near = rows[np.abs(rows[:, 0]) < 2.0]
    straight = np.hypot(near[:, 2], near[:, 3]) > 0.5
    assert straight.mean() > 0.95
    turned = np.degrees(np.arctan2(near[straight, 2], np.abs(near[straight, 3])))
    assert np.sqrt(np.mean(turned**2)) < 2.0
    assert np.abs(np.abs(near[straight, 1]) - 1.0).mean() < 0.006


@pytest.mark.parametrize("start", [0, 90, 200])
@pytest.mark.parametrize("backward", [False, True])
def test_the_sweep_may_start_anywhere_and_turn_either_way(start: int, backward: bool) -> None:
    scan = room_scan(np.array([0.3, 0.1, 0.0]))
    points = np.roll(scan.points, start, axis=0)[:: -1 if backward else 1]
    turned = Scan(np.ascontiguousarray(points), scan.origin, scan.missing, 20.0, np.radians(1.0))
    rows = prepare_scan(turned, CONFIG).rows
    assert np.all(np.diff(rows[:, 4]) > 0)
    assert len(rows) == pytest.approx(len(prepare_scan(scan, CONFIG).rows), abs=3)


def test_a_scan_without_returns_is_empty() -> None:
    empty = Scan(np.zeros((0, 2), np.float32), np.zeros(3), np.zeros(0, np.float32), 5.0, 0.01)
    assert len(prepare_scan(empty, CONFIG).rows) == 0
    nans = Scan(np.full((9, 2), np.nan, np.float32), np.zeros(3), empty.missing, 5.0, 0.01)
    assert len(prepare_scan(nans, CONFIG).rows) == 0


@settings(max_examples=30)
@given(st.floats(-6, 6), st.floats(-6, 6), st.floats(0.05, 1.0), st.floats(-0.01, 0.99))
def test_nearest_agrees_with_trying_every_point(
    x: float, y: float, reach: float, start: float
) -> None:
    """From wherever the search begins."""
    rows = prepared([0.5, -0.4, 0.7]).rows
    first = int(np.floor(start * len(rows)))
    found, _ = nearest(rows, 0, len(rows), x, y, 0.0, 0.0, reach, max(first, -1))
    distances = np.hypot(rows[:, 0] - x, rows[:, 1] - y)
    if distances.min() >= reach:
        assert found == -1
    elif np.abs(np.arctan2(y, x) - rows[distances.argmin(), 4]) < 1.4:
        assert distances[found] == pytest.approx(distances.min())


@settings(max_examples=15)
@given(st.floats(-0.2, 0.2), st.floats(-0.2, 0.2), st.floats(-0.15, 0.15))
def test_a_match_finds_the_true_motion(x: float, y: float, yaw: float) -> None:
    first, second = np.array([0.4, 0.3, 0.2]), np.array([0.7, 0.1, 0.35])
    targets = scan_set([prepare_scan(room_scan(first, seed=1), CONFIG)])
    scan = prepare_scan(room_scan(second, seed=2), CONFIG)
    truth = between_planar(first, second)
    guess = truth + np.array([x, y, yaw])
    match = match_scan(scan, targets, np.zeros((1, 3)), guess, CONFIG, max_distances=COARSE)
    error = between_planar(truth, match.pose)
    assert np.hypot(*error[:2]) < 0.006
    assert abs(error[2]) < 0.002
    assert match.overlap > 0.9


def test_a_room_is_known_in_every_direction_a_corridor_only_across() -> None:
    """Along a corridor both walls' normals are orthogonal to the motion: no information."""
    poses = np.zeros((1, 3))
    room = scan_set([prepared([0.0, 0.0, 0.0])])
    in_room = match_scan(room.one(0), room, poses, np.zeros(3), CONFIG)
    sigma = np.sqrt(np.linalg.inv(in_room.information)[[0, 1], [0, 1]])
    assert sigma.max() < 0.01
    hall = scan_set([prepared([0.0, 0.0, 0.0], room=CORRIDOR)])
    in_hall = match_scan(hall.one(0), hall, poses, np.zeros(3), CONFIG)
    assert in_hall.information[0, 0] < 1e-3 * in_hall.information[1, 1]


@pytest.mark.parametrize("noise", [0.003, 0.01, 0.03])
def test_the_noise_of_normals_is_no_knowledge_along_a_corridor(noise: float) -> None:
    """Their squared errors add up, however many they are; where a room has corners, they count."""
    poses = np.zeros((1, 3))
    shares = []
    for room in (CORRIDOR, BOX):
        seen = [
            prepare_scan(room_scan(np.zeros(3), room, seed=k, noise=noise, reach=4.5), CONFIG)
            for k in range(40)
        ]
        found, normals = np.zeros((3, 3)), np.zeros((2, 2))
        for target, scan in itertools.pairwise(seen):
            targets = scan_set([target])
            match = match_scan(scan, targets, poses, np.zeros(3), CONFIG)
            found += match.information
            rows = target.rows[:, 2:4].astype(np.float64)
            normals += rows.T @ rows
        shares.append((found[0, 0] / found[1, 1]) / (normals[0, 0] / normals[1, 1]))
    assert shares[0] < 0.35
    assert shares[1] == pytest.approx(1.0, rel=0.1)


def test_a_prior_holds_what_the_match_is_degenerate() -> None:
    """Along a corridor the pose stays where the prior puts it, and the match takes no credit."""
    hall = scan_set([prepared([0.0, 0.0, 0.0], room=CORRIDOR)])
    guess, known = np.array([0.2, 0.05, 0.02]), np.diag([1e4, 1e-3, 1e-3])
    match = match_scan(hall.one(0), hall, np.zeros((1, 3)), guess, CONFIG, prior_information=known)
    assert match.pose[0] == pytest.approx(0.2, abs=0.01)
    assert match.pose[1:] == pytest.approx([0.0, 0.0], abs=0.002)
    assert match.information[0, 0] < 1e3


def test_information_counts_points_over_the_variance_of_one() -> None:
    """Many wall points seen head-on know the distance to them with variance sigma^2 c / n."""
    points = np.stack([np.full(41, 2.0), np.linspace(-1, 1, 41)], axis=-1).astype(np.float32)
    wall = Scan(points, np.zeros(3), np.zeros(0, np.float32), 10.0, np.radians(1.5))
    scans = scan_set([prepare_scan(wall, CONFIG)])
    match = match_scan(scans.one(0), scans, np.zeros((1, 3)), np.zeros(3), CONFIG)
    expected = len(scans.rows) / (CONFIG.range_sigma**2 * CONFIG.correlation)
    assert match.information[0, 0] == pytest.approx(expected, rel=1e-6)
    assert match.information[1, 1] == pytest.approx(0.0, abs=1e-6 * expected)


def test_a_scan_that_does_not_say_how_its_beams_lie_is_prepared_as_one_that_does() -> None:
    scan = room_scan(np.zeros(3), seed=1)
    unsaid = prepare_scan(replace(scan, angle_increment=np.nan), CONFIG)
    np.testing.assert_allclose(unsaid.rows, prepare_scan(scan, CONFIG).rows, atol=1e-6)
    coarse = prepare_scan(replace(scan, angle_increment=5.0 * scan.angle_increment), CONFIG)
    assert coarse.rows.shape != unsaid.rows.shape or not np.allclose(coarse.rows, unsaid.rows)


def seen_from_origin(points: np.ndarray) -> Submap:
    return Submap(points, np.zeros((1, 2)), np.array([0, len(points)]))


@pytest.mark.parametrize("side", [16, 1])  # squares of 8 cells to each side of a block
@pytest.mark.parametrize("x", [0.2, -4.0, 5.0])  # from which shifts lead beyond the grid
def test_branch_and_bound_finds_what_trying_every_pose_finds(side: int, x: float) -> None:
    random = np.random.default_rng(3)
    grid = evidence_grid(seen_from_origin(random.uniform(-3, 3, (60, 2))))
    points = random.uniform(-2, 2, (25, 2))
    guess, angles, reach = np.array([x, -0.1, 0.1]), np.arange(-2, 3) * 0.2, 15
    starts = np.arange(-reach, reach + 1, 8 * side)
    blocks = np.stack(np.meshgrid(starts, starts), axis=-1).reshape(-1, 2)
    found = np.zeros(4)
    nowhere = np.array([0.0, 0.0, 0.0, -1.0, -1.0])
    best_shift(
        grid.pyramid, grid.strips, points, grid.corner, guess, blocks, side, reach, angles, 0.0,
        nowhere, found,
    )  # fmt: skip
    assert found[0] == pytest.approx(_best_by_trying(grid, points, guess, angles, reach), abs=1e-6)


def _best_by_trying(grid, points, guess, angles, reach) -> float:  # type: ignore[no-untyped-def]
    field, best = grid.pyramid[0] / 255.0, 0.0
    for angle in angles:
        at = transform_points_planar(guess + np.array([0.0, 0.0, angle]), points)
        cells = np.floor((at - grid.corner) / RESOLUTION).astype(int) + SQUARE
        for dx in range(-reach, reach + 1):
            for dy in range(-reach, reach + 1):
                x, y = (cells + np.array([dx, dy])).T
                inside = (x >= 0) & (y >= 0) & (x < field.shape[1]) & (y < field.shape[0])
                outside = np.count_nonzero(~inside) * UNSEEN / 255.0
                best = max(best, (field[y[inside], x[inside]].sum() + outside) / len(points))
    return best


def test_a_search_finds_a_scan_turned_round_and_names_the_second_best() -> None:
    """A rectangle looks the same after half a turn: the other pose must show as second best."""
    target = prepared([0.0, 0.0, 0.0]).rows[:, :2].astype(np.float64)
    scan = prepared([1.5, -1.0, 2.0]).rows[:, :2].astype(np.float64)
    grid = evidence_grid(seen_from_origin(target))
    found = search_evidence(scan, grid, np.zeros(3), 4.0, np.pi, 20.0)
    assert found is not None
    truth = np.array([1.5, -1.0, 2.0])
    # The room's centre is at (0.5, 0.5), about which half a turn changes nothing.
    other = np.array([1.0 - 1.5, 1.0 + 1.0, 2.0 - np.pi])
    errors = [np.hypot(*between_planar(p, found.pose)[:2]) for p in (truth, other)]
    assert min(errors) < 0.15
    assert found.second_best > 0.9 * found.score


def test_a_pair_seen_from_either_end_is_the_same() -> None:
    a, b = np.array([0.2, 0.1, 0.3]), np.array([0.6, -0.2, 0.7])
    scans = scan_set([prepared(list(a), seed=1), prepared(list(b), seed=2)])
    poses = np.stack([a, compose_planar(b, [0.02, -0.01, 0.005])])
    systems = np.zeros((2, 15))
    pairs = np.array([[0, 1], [1, 0]], np.int64)
    pair_systems(0, 2, scans.rows, scans.bounds, scans.origins, pairs, poses, 0.3, 0.05, systems)
    upper = np.array([[0, 1, 2], [1, 3, 4], [2, 4, 5]])
    there, back = systems[:, upper]
    # A step of the second scan is the opposite step of the first, seen in the first's frame.
    adjoint = planar_adjoint(between_planar(poses[1], poses[0]))
    np.testing.assert_allclose(adjoint.T @ there @ adjoint, back, rtol=1e-6, atol=1e-6)
    np.testing.assert_allclose(-adjoint.T @ systems[0, 6:9], systems[1, 6:9], rtol=1e-6, atol=1e-6)
    assert systems[0, 9] == pytest.approx(systems[1, 9])
    of_normals, turn = systems[:, [[12, 13], [13, 14]]], adjoint[:2, :2]
    np.testing.assert_allclose(turn.T @ of_normals[0] @ turn, of_normals[1], rtol=1e-6, atol=1e-6)


def test_the_adjoint_carries_small_motions_across() -> None:
    a_from_b, small = np.array([1.0, -2.0, 0.8]), np.array([1e-6, -2e-6, 3e-6])
    left = compose_planar(planar_adjoint(a_from_b) @ small, a_from_b)
    np.testing.assert_allclose(left, compose_planar(a_from_b, small), atol=1e-11)


def steps_between(motions: np.ndarray, information: np.ndarray) -> System:
    """Scans, each a motion after the one before, all of this information; none is held."""
    count = len(motions)
    ends, free = np.arange(count + 1), np.arange(count + 1)
    known = np.tile(information, (count, 1, 1))
    return System(True, ends[:-1], ends[1:], motions, known, free)


@pytest.mark.parametrize("threads", [1, 3])
def test_joint_alignment_brings_scattered_scans_home(threads: int) -> None:
    random = np.random.default_rng(5)
    truth = np.stack(
        [np.linspace(-2, 2, 12), np.sin(np.linspace(0, 3, 12)), np.linspace(0, 6, 12)], axis=-1
    )
    scans = scan_set(
        [prepare_scan(room_scan(pose, seed=k), CONFIG) for k, pose in enumerate(truth)]
    )
    start = compose_planar(truth, random.normal(size=(12, 3)) * [0.06, 0.06, 0.03])
    start[0] = truth[0]
    pairs = np.array([(i, j) for i in range(12) for j in range(i + 1, 12)], np.int64)
    weak = steps_between(between_planar(start[:-1], start[1:]), np.eye(3))
    max_distances = np.array([0.4, 0.3, 0.2, 0.12, 0.12])
    rest = (lambda _: pairs), Config(threads=threads), Silent(), max_distances
    solved = align_in_rounds(scans, weak, start, *rest)
    error = compose_planar(invert_planar(truth), solved.poses[:12])
    assert np.hypot(error[:, 0], error[:, 1]).max() < 0.005
    assert np.abs(error[:, 2]).max() < 0.002
    assert solved.moved[-1] < solved.moved[0] / 10
    held = np.arange(12) % 3 == 0
    placed = np.where(held[:, None], truth, start)
    solved = align_in_rounds(scans, weak.held(held), placed, *rest)
    np.testing.assert_array_equal(solved.poses[:12][held, :2], truth[held, :2])
    error = compose_planar(invert_planar(truth), solved.poses[:12])
    assert np.hypot(error[:, 0], error[:, 1]).max() < 0.005


def test_pairs_count_by_how_well_they_agree() -> None:
    """Ranges that err by a third as much say up to nine times as much, by one setting for all."""
    truth = np.stack([np.linspace(-2, 2, 12), np.zeros(12), np.linspace(0, 1, 12)], axis=-1)
    motions = steps_between(between_planar(truth[:-1], truth[1:]), np.eye(3))
    pairs = np.array([(i, j) for i in range(12) for j in range(i + 1, 12)], np.int64)
    known = []
    for noise in (0.003, 0.009):
        seen = [room_scan(pose, seed=k, noise=noise) for k, pose in enumerate(truth)]
        scans = scan_set([prepare_scan(scan, CONFIG) for scan in seen])
        rest = (lambda _: pairs), Config(threads=1), Silent()
        solved = align_in_rounds(scans, motions, truth, *rest)
        known.append(np.median(solved.joint.information[-len(pairs) :, 0, 0]))
    assert 3.0 < known[0] / known[1] < 15.0


@pytest.mark.parametrize("noise", [0.003, 0.01, 0.03])
def test_pairs_know_nothing_along_a_corridor(noise: float) -> None:
    """As two scans of a match; once the noise of all pairs drew a corridor together."""
    count, shares = 40, []
    pairs = np.array([(k, k + 1) for k in range(count - 1)], np.int64)
    for room in (CORRIDOR, BOX):
        seen = [room_scan(np.zeros(3), room, seed=k, noise=noise, reach=4.5) for k in range(count)]
        scans, systems = prepare_scans(seen, CONFIG), np.zeros((count - 1, 15))
        pair_systems(
            0, count - 1, scans.rows, scans.bounds, scans.origins, pairs, np.zeros((count, 3)),
            0.12, 0.12, systems,
        )  # fmt: skip
        normals = np.square(scans.rows[:, 2:4].astype(np.float64)).sum(axis=0)
        known = pair_edges(np.zeros((count, 3)), pairs, systems, 1.0)[3].sum(axis=0)
        shares.append((known[0, 0] / known[1, 1]) / (normals[0] / normals[1]))
    assert shares[0] < 0.35
    assert shares[1] == pytest.approx(1.0, rel=0.1)


def test_pairs_that_know_next_to_nothing_count_without_a_warning() -> None:
    """Errors of normals over what is known overflowed where that is all but nothing."""
    systems = np.zeros((3, 15))
    systems[1:, 3], systems[1:, 12], systems[2, 0] = 1.0, 1e9, -1e-20
    kept = without_noise(systems)
    np.testing.assert_allclose(kept[0], np.eye(3))
    np.testing.assert_allclose(kept[1:], np.tile(np.diag([0.0, 1.0, 1.0]), (2, 1, 1)), atol=1e-9)


@pytest.mark.parametrize("sight", [1.2, 1.5, 2.0])
def test_scans_of_a_short_sighted_laser_are_not_torn_apart(sight: float) -> None:
    """Where scans share few points, some that join or leave change what pairs say much."""
    count = 40
    random, along = np.random.default_rng(3), np.linspace(0, 1, count)
    truth = np.stack([7 * along - 3, np.sin(6 * along), 2 * np.sin(9 * along)], axis=-1)
    seen = [cast(pose, WALLS, seed) for seed, pose in enumerate(truth)]
    near = [replace(s, points=s.points[np.hypot(*s.points.T) < sight]) for s in seen]
    start = truth + random.normal(size=(count, 3)) * [0.05, 0.05, 0.03]
    start[0] = truth[0]
    pairs = np.array([(k, k + d) for d in (1, 2, 4, 8) for k in range(count - d)], np.int64)
    steps = between_planar(truth[:-1], truth[1:])
    noisy = steps + random.normal(size=steps.shape) * 0.02
    motions = steps_between(noisy, np.diag([100.0, 100.0, 400.0]))
    scans = prepare_scans(near, CONFIG)
    max_distances = np.full(12, 0.12)
    rest = (lambda _: pairs), Config(threads=1), Silent(), max_distances
    solved = align_in_rounds(scans, motions, start, *rest)
    assert solved.moved[-1] < solved.moved[0] / 10
    error = between_planar(truth, solved.poses[:count])
    assert np.hypot(error[:, 0], error[:, 1]).max() < 0.3  # by odometry alone: 0.02 m a step


@settings(max_examples=30)
@given(st.integers(0, 10_000))
def test_small_systems_are_solved_as_numpy_does(seed: int) -> None:
    factor = np.random.default_rng(seed).normal(size=(3, 3))
    matrix, right = factor @ factor.T + 0.1 * np.eye(3), factor[:, 0].copy()
    np.testing.assert_allclose(invert3(matrix), np.linalg.inv(matrix), rtol=1e-6, atol=1e-9)
    np.testing.assert_allclose(solve3(matrix, right), np.linalg.solve(matrix, right), atol=1e-6)
