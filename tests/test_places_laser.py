"""Loop closures by scans: true ones found from poor guesses, aliases refused."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from laser_rooms import WALLS, cast
from numpy.typing import NDArray
from sample_verdicts import REJECTED

from formats.database import MemoryMap
from mapmyworld.alignment.laser_pairs import among_first_revisits, field_of_view, neighbour_pairs
from mapmyworld.api import Silent
from mapmyworld.config import Config
from mapmyworld.geometry.planar import (
    between_planar,
    compose_planar,
    information_from_planar,
    matrix_to_planar,
    planar_to_matrix,
)
from mapmyworld.graph.solved_graph import solve
from mapmyworld.places import laser_closures
from mapmyworld.places.laser_candidates import (
    EVERYWHERE,
    candidate_pairs,
    lost_pairs,
    pairs_about,
    untied,
)
from mapmyworld.places.laser_closures import compare_places
from mapmyworld.places.laser_nodes import NodeScans, calm_spots, laser_nodes
from mapmyworld.places.laser_submaps import submap_members
from mapmyworld.registration.scan_matching import prepare_scan, scan_set
from mapmyworld.registration.submaps import POINTS
from mapmyworld.types import (
    ConstraintKind,
    ImageMatch,
    Judge,
    Judged,
    Node,
    Poses,
    ScanMatch,
    Verdict,
    Why,
)
from mapmyworld.types.wording import reason_of

CONFIG = Config()


def drive(
    believed: NDArray[np.float64], *, at: int = 0, metres: float = 0.0, radians: float = 0.0
) -> list[Judged]:
    """Motions between nodes at poses (N, 3), known to 1 cm and 0.1 degrees; less known to one."""
    steps = planar_to_matrix(between_planar(believed[:-1], believed[1:]))
    sigmas = np.tile([0.01, 0.01, 0.002], (len(believed), 1))
    sigmas[at] += metres, metres, radians
    return [
        Judged(
            from_id=k, to_id=k + 1, kind=ConstraintKind.NEIGHBOUR, i_from_j=step,
            information=information_from_planar(np.diag(sigmas[k + 1] ** -2.0)),
        )
        for k, step in enumerate(steps)
    ]  # fmt: skip


def two_visits() -> NDArray[np.float64]:
    """(N, 3) true poses: through both rooms, back, and through them again."""
    there = np.stack([np.linspace(-2.5, 2.3, 49), np.full(49, 0.5), np.zeros(49)], axis=-1)
    back = there[::-1] + np.array([0.0, 0.0, np.pi])
    return np.concatenate([there, back, there])


def closures(
    walls: NDArray[np.float64],
    believed: NDArray[np.float64],
    *,
    optimised: bool = False,
    threads: int = 2,
) -> list[Judged]:
    scans = scan_set(
        [prepare_scan(cast(p, walls, k), CONFIG.registration) for k, p in enumerate(two_visits())]
    )
    motions = drive(believed, at=98, metres=0.3, radians=0.02)
    nodes = laser_nodes(np.arange(len(believed), dtype=np.int64), scans, believed, motions)
    pairs = candidate_pairs(nodes, CONFIG, optimised=optimised)
    return compare_places(nodes, pairs, replace(CONFIG, threads=threads))


def test_drift_is_found_and_measured() -> None:
    """The second visit is believed 0.4 m and 2 degrees off: the constraints know better."""
    truth = two_visits()
    believed = truth.copy()
    believed[98:] = compose_planar([0.4, -0.2, np.radians(2.0)], truth[98:])
    tried = closures(WALLS, believed)
    accepted = [c for c in tried if c.accepted and c.to_id >= 98]
    assert len(accepted) >= 2
    for c in accepted:
        error = between_planar(
            between_planar(truth[c.from_id], truth[c.to_id]), matrix_to_planar(c.i_from_j)
        )
        assert np.hypot(*error[:2]) < 0.03
        assert abs(error[2]) < 0.01
    assert all(reason_of(c) for c in tried)


def test_a_corridor_closes_nothing() -> None:
    """Two parallel walls fit at any place along them."""
    walls = np.array([[-99.0, -1.0, 99.0, -1.0], [-99.0, 2.0, 99.0, 2.0]])
    assert not [c for c in closures(walls, two_visits()) if c.accepted]


def corridor_with_doors(*more: list[float]) -> NDArray[np.float64]:
    """40 m of corridor with a recess every 4 m on the left, and more walls."""
    walls = [[-20.0, -1.0, 20.0, -1.0], *more]
    for x in np.arange(-20.0, 20.0, 4.0):
        walls += [[x, 1.0, x + 3.0, 1.0], [x + 3.0, 1.0, x + 3.0, 1.4]]
        walls += [[x + 3.0, 1.4, x + 4.0, 1.4], [x + 4.0, 1.4, x + 4.0, 1.0]]
    return np.array(walls)


def second_drive_along_it(
    walls: NDArray[np.float64], *, drift: float = -3.6, sigma: float = 2.0
) -> tuple[NDArray[np.float64], list[Judged]]:
    """True poses, and closures tried after 150 m that drifted by about a door's distance."""
    there = np.stack([np.linspace(-8.0, 8.0, 81), np.zeros(81), np.zeros(81)], axis=-1)
    truth = np.concatenate([there, there])
    believed = truth.copy()
    believed[81:, 0] += drift
    scans = scan_set(
        [prepare_scan(cast(p, walls, k), CONFIG.registration) for k, p in enumerate(truth)]
    )
    motions = drive(believed, at=81, metres=sigma, radians=0.1)
    nodes = laser_nodes(np.arange(len(truth), dtype=np.int64), scans, believed, motions)
    nodes = replace(nodes, path=nodes.path + 150.0 * (np.arange(len(truth)) >= 81))
    pairs = candidate_pairs(nodes, CONFIG, optimised=False)
    return truth, compare_places(nodes, pairs, CONFIG)


def test_one_of_many_equal_doors_is_not_taken_for_another() -> None:
    truth, tried = second_drive_along_it(corridor_with_doors())
    whys = {c.verdicts[-1].why for c in tried}
    assert {Why.AMBIGUOUS_POSE, Why.AMBIGUOUS_PLACE} <= whys
    assert worst_error(truth, tried) < 0.05


def worst_error(truth: NDArray[np.float64], tried: list[Judged]) -> float:
    """Metres by which accepted closures of two drives are off, at most; 0 where there are none."""
    off = [
        between_planar(
            between_planar(truth[c.from_id], truth[c.to_id]), matrix_to_planar(c.i_from_j)
        )
        for c in tried
        if c.accepted and c.to_id >= 81 > c.from_id
    ]
    return max((float(np.hypot(*error[:2])) for error in off), default=0.0)


def test_drift_tells_equal_doors_apart() -> None:
    """What is a door farther on explains the scans as well, and lies four sigmas off."""
    truth, tried = second_drive_along_it(corridor_with_doors(), drift=-0.7, sigma=0.6)
    joined = [c for c in tried if c.to_id >= 81 > c.from_id]
    assert len([c for c in joined if c.accepted]) > 0.7 * len(joined)
    assert worst_error(truth, tried) < 0.05


def test_a_place_like_no_other_is_recognised_between_equal_doors() -> None:
    cupboard = [[1.0, -1.0, 1.0, 0.3], [1.0, 0.3, 3.0, 0.3], [3.0, 0.3, 3.0, -1.0]]
    truth, tried = second_drive_along_it(corridor_with_doors(*cupboard))
    assert [c for c in tried if c.accepted and c.to_id >= 81 > c.from_id]
    assert worst_error(truth, tried) < 0.05


def test_what_lies_farther_along_the_corridor_tells_equal_doors_apart() -> None:
    """Places at its begin show equal doors alone: some differ by drift, others by what longer
    submaps show 15 m ahead.
    """
    cupboard = [[12.0, -1.0, 12.0, 0.3], [12.0, 0.3, 13.0, 0.3], [13.0, 0.3, 13.0, -1.0]]
    truth, tried = second_drive_along_it(corridor_with_doors(*cupboard))
    began = [c for c in tried if truth[c.to_id, 0] < -3.0 and c.to_id >= 81 > c.from_id]
    evidence = [c.source.evidence for c in began if isinstance(c.source, ScanMatch) and c.accepted]
    assert max(evidence) > 2.0 * POINTS  # more than ordinary ones have
    assert worst_error(truth, began) < 0.05


@pytest.mark.parametrize("optimised", [False, True])
def test_the_result_does_not_depend_on_threads(optimised: bool) -> None:
    first = closures(WALLS, two_visits(), optimised=optimised, threads=1)
    again = closures(WALLS, two_visits(), optimised=optimised, threads=3)
    assert [c.i_from_j.tobytes() for c in first] == [c.i_from_j.tobytes() for c in again]


def test_neighbours_grow_with_the_drive_not_with_its_square() -> None:
    lap = np.stack([np.linspace(0, 30, 100), np.zeros(100), np.zeros(100)], axis=-1)
    one = len(neighbour_pairs(np.tile(lap, (4, 1)), 4.0, 4, np.pi))
    two = len(neighbour_pairs(np.tile(lap, (16, 1)), 4.0, 4, np.pi))
    assert two < 5 * one


def test_first_visits_grow_with_the_area_not_with_the_laps() -> None:
    lap = np.stack([np.linspace(0, 30, 100), np.zeros(100), np.zeros(100)], axis=-1)
    back = lap[::-1] + np.array([0.0, 0.1, np.pi])
    poses, laps = np.concatenate([lap, back, lap, back]), np.tile(lap, (12, 1))
    twice = among_first_revisits(poses[:, :2], poses[:, 2], 1)
    np.testing.assert_array_equal(twice, np.arange(400) < 200)  # a heading is a visit of its own
    assert among_first_revisits(laps[:, :2], laps[:, 2], 3).sum() == 300


def test_other_visits_are_looked_for_among_some_only() -> None:
    lap = np.stack([np.linspace(0, 30, 100), np.zeros(100), np.zeros(100)], axis=-1)
    poses = np.tile(lap, (3, 1))
    among = np.arange(300) < 100
    pairs = neighbour_pairs(poses, 4.0, 4, np.pi, among)
    afar = pairs[np.diff(pairs, axis=1)[:, 0] > 12]  # nearer ones are of one visit
    assert len(afar) >= 200
    assert among[afar].any(axis=1).all()


def test_visits_are_compared_as_far_as_both_see_the_same_sides() -> None:
    """Facing the other way, half a turn of view shows the other sides of jambs; a full one not."""
    lap = np.stack([np.linspace(0, 30, 100), np.zeros(100), np.zeros(100)], axis=-1)
    back, again = np.array([0.0, 0.1, np.pi]), np.array([0.0, 0.2, 0.0])
    poses = np.concatenate([lap, lap[::-1] + back, lap + again])
    for degrees, compared in ((180, False), (360, True)):
        field = field_of_view(np.radians(np.arange(-90.0, degrees - 90.0)).astype(np.float32))
        assert field == pytest.approx(np.radians(degrees), abs=0.2)
        pairs = neighbour_pairs(poses, 4.0, 4, 0.5 * field)
        first, second = pairs[np.diff(pairs, axis=1)[:, 0] > 12].T // 100
        assert np.any((first == 0) & (second == 2))
        assert np.any(first + 1 == second) == compared


def test_a_drive_that_comes_back_after_500_m_of_drift_is_closed() -> None:
    """Believed 18 m and 60 degrees from where it is; only the widened search reaches that far.

    The rooms look nearly the same turned by half a turn: the graph must refuse such closures.
    """
    truth = two_visits()
    believed = truth.copy()
    believed[98:] = compose_planar([14.0, -11.0, np.radians(60.0)], truth[98:])
    scans = scan_set(
        [prepare_scan(cast(p, WALLS, k), CONFIG.registration) for k, p in enumerate(truth)]
    )
    ids = np.arange(len(truth), dtype=np.int64)
    motions = drive(believed, at=98, metres=10.0, radians=1.0)
    nodes = laser_nodes(ids, scans, believed, motions)
    nodes = replace(nodes, path=nodes.path + 500.0 * (np.arange(len(truth)) >= 98))
    pairs = lost_pairs(nodes, CONFIG)
    assert pairs
    tried = compare_places(nodes, pairs, CONFIG, EVERYWHERE)
    solved = solve(nodes.ids, planar_to_matrix(believed), [*motions, *tried], True)
    error = between_planar(truth, matrix_to_planar(solved.poses.map_from_node))[98:]
    assert np.hypot(error[:, 0], error[:, 1]).max() < 0.05
    assert np.abs(error[:, 2]).max() < 0.01


def test_about_a_likely_pair_its_neighbours_are_compared() -> None:
    """Believed 18 m off; a pair with more evidence than chance, and too little, says where."""
    truth = two_visits()
    believed = truth.copy()
    believed[98:] = compose_planar([14.0, -11.0, np.radians(60.0)], truth[98:])
    ids = np.arange(len(truth), dtype=np.int64)
    nodes = laser_nodes(ids, scan_set([]), believed)
    nodes = replace(nodes, path=nodes.path + 500.0 * (np.arange(len(truth)) >= 98))

    def about(evidence: float, why: Why = Why.LITTLE_EVIDENCE) -> list[tuple[int, int]]:
        numbers = {"evidence": evidence, "limit": 80.0}
        pose = planar_to_matrix(between_planar(truth[10], truth[112]))
        found = Judged(
            10, 112, ConstraintKind.LOOP_CLOSURE, pose, np.eye(6),
            verdicts=(Verdict(Judge.LASER, False, why, numbers),),
        )  # fmt: skip
        return pairs_about(nodes, [found], CONFIG)

    pairs = np.array(about(65.0))
    assert len(np.unique(pairs[:, 1])) >= 2
    apart = truth[pairs[:, 0], :2] - truth[pairs[:, 1], :2]
    assert (np.hypot(*apart.T) < 1.5).all()
    assert (pairs[:, 0] < 98).all()
    assert (pairs[:, 1] >= 98).all()
    assert about(55.0) == about(65.0, Why.NOTHING_IN_COMMON) == []


def test_a_likely_pair_is_followed_by_its_neighbours(monkeypatch: pytest.MonkeyPatch) -> None:
    """Whatever is compared shows the right pose, and one point too little evidence for it."""
    truth = two_visits()
    believed = truth.copy()
    believed[98:] = compose_planar([14.0, -11.0, np.radians(60.0)], truth[98:])
    matrices, count = planar_to_matrix(believed), len(truth)
    nodes = [Node(k, 1, k, pose, pose) for k, pose in enumerate(matrices)]
    sees = np.ones(count, np.bool_)
    loaded = NodeScans(nodes, scan_set([]), ~sees, sees, ~sees)
    asked: list[list[tuple[int, int]]] = []

    def compared(_: object, pairs: list[tuple[int, int]], *given: object) -> list[Judged]:
        if not pairs or EVERYWHERE not in given:
            return []
        asked.append(pairs)
        verdict = Verdict(
            Judge.LASER, False, Why.LITTLE_EVIDENCE, {"evidence": 79.0, "limit": 80.0}
        )
        poses = planar_to_matrix(between_planar(*(truth[np.array(pairs)[:, k]] for k in (0, 1))))
        return [
            Judged(a, b, ConstraintKind.LOOP_CLOSURE, pose, np.eye(6), verdicts=(verdict,))
            for (a, b), pose in zip(pairs, poses, strict=True)
        ]

    monkeypatch.setattr(laser_closures, "compare_places", compared)
    poses = Poses(np.arange(count), matrices)
    motions = drive(believed, at=98, metres=10.0, radians=1.0)
    laser_closures.find_laser_closures(MemoryMap(), poses, CONFIG, Silent(), loaded, motions)
    lost, about = asked[:2]
    apart = np.hypot(*(truth[[a for a, _ in about], :2] - truth[[b for _, b in about], :2]).T)
    assert not set(lost) & set(about)
    assert (apart < 1.5).all()


def test_places_are_looked_for_as_far_as_the_neighbour_constraints_state() -> None:
    """Believed 18 m off after 100 m: far for wheels, near where a heading was lost on the way."""
    truth = two_visits()
    believed = truth.copy()
    believed[98:] = compose_planar([14.0, -11.0, np.radians(60.0)], truth[98:])
    ids = np.arange(len(truth), dtype=np.int64)

    def pairs(motions: list[Judged]) -> list[tuple[int, int]]:
        return lost_pairs(laser_nodes(ids, scan_set([]), believed, motions), CONFIG)

    assert pairs(drive(believed)) == []
    found = pairs(drive(believed, at=98, metres=10.0, radians=1.0))
    assert found
    assert all(a < 98 <= b for a, b in found)


def test_chance_grows_with_the_places_that_are_looked_at_and_not_with_the_reach() -> None:
    """Drift of a kilometre is searched at so many places, as one of 60 m is: chance is alike."""
    truth = two_visits()
    scans = scan_set(
        [prepare_scan(cast(p, WALLS, k), CONFIG.registration) for k, p in enumerate(truth)]
    )
    limits = []
    for metres in (30.0, 300.0):
        motions = drive(truth, at=98, metres=metres, radians=0.1)
        nodes = laser_nodes(np.arange(len(truth), dtype=np.int64), scans, truth, motions)
        (found,) = compare_places(nodes, [(20, 118)], CONFIG, EVERYWHERE)
        assert found.accepted
        limits.append(found.verdicts[-1].numbers["limit"])
    assert limits[0] == pytest.approx(limits[1], rel=1e-9)


def test_no_submap_spans_odometry_in_doubt() -> None:
    poses, never = np.zeros((40, 3)), np.zeros(40, np.bool_)
    poses[:, 0] = 0.1 * np.arange(40)
    nodes = laser_nodes(np.arange(1, 41), scan_set([]), poses, (), never, np.arange(40) == 20)
    assert submap_members(nodes, 19, CONFIG).max() == 19
    assert submap_members(nodes, 20, CONFIG).min() == 20
    assert not nodes.session.any()


def test_where_closures_hold_the_drive_nothing_is_lost() -> None:
    truth = two_visits()
    scans = scan_set(
        [prepare_scan(cast(truth[0], WALLS, 0), CONFIG.registration) for _ in range(len(truth))]
    )
    known = information_from_planar(np.diag(np.array([0.4, 0.4, 0.02]) ** -2.0))
    steps = [replace(c, information=known) for c in drive(truth)]
    closed = [
        Judged(
            from_id=k, to_id=k + 98, kind=ConstraintKind.LOOP_CLOSURE,
            i_from_j=np.eye(4), information=1e8 * np.eye(6),
        )
        for k in range(0, 49, 4)
    ]  # fmt: skip
    ids, path = np.arange(len(truth), dtype=np.int64), np.linspace(0.0, 600.0, len(truth))
    loose, held = (
        replace(laser_nodes(ids, scans, truth, some), path=path)
        for some in (steps, [*steps, *closed])
    )
    assert lost_pairs(loose, CONFIG)
    pairs = np.array(lost_pairs(held, CONFIG))
    assert len(pairs)
    (joined,), (between,) = (
        held.drift.reach(*np.array(ends)) for ends in ([[0], [98]], [[46], [144]])
    )
    assert joined[0] == pytest.approx(0.0, abs=1e-3)
    assert between[0] < 2.0
    assert (held.drift.reach(*pairs.T)[:, 0] > 3.0).all()
    both = pairs[(pairs[:, 0] < 49) & (pairs[:, 1] >= 98)]
    assert (np.abs(both[:, 1] - 98 - both[:, 0]) >= 9).all()


def test_a_place_is_compared_from_where_the_robot_turns_evenly() -> None:
    """A sweep in which a turn began stands for nothing; its neighbours see the same place."""
    poses = np.zeros((60, 3))
    poses[:, 0] = 0.1 * np.arange(60)
    straight = laser_nodes(np.arange(60), scan_set([]), poses)
    spots = calm_spots(straight, 1.0)
    assert (straight.path[spots] // 1.0).tolist() == [0, 1, 2, 3, 4, 5]
    poses[spots[2] :, 2] = 0.03  # the turn lies between two nodes: both ends of it are uneven
    turned = laser_nodes(np.arange(60), scan_set([]), poses)
    found = calm_spots(turned, 1.0)
    assert not {spots[2] - 1, spots[2]} & set(found.tolist())
    assert (turned.path[found] // 1.0).tolist() == [0, 1, 2, 3, 4, 5]


def test_no_place_is_passed_over_where_nodes_lie_as_far_apart_as_places() -> None:
    """Key scans, a metre apart in turns of a radian: each is a place of its own."""
    poses = np.zeros((20, 3))
    poses[:, 0], poses[10, 2] = 1.1 * np.arange(20), 1.0
    nodes = laser_nodes(np.arange(20), scan_set([]), poses)
    assert calm_spots(nodes, 1.0).tolist() == list(range(20))


def test_joined_places_are_not_compared_again() -> None:
    """A closure between rows 5 and 105 says what one between rows 6 and 106 would."""
    poses = np.zeros((200, 3))
    poses[:, 0] = 0.2 * np.arange(200)
    nodes = laser_nodes(np.arange(200), scan_set([]), poses)
    closure = Judged(
        from_id=5, to_id=105, kind=ConstraintKind.LOOP_CLOSURE, i_from_j=np.eye(4),
        information=np.eye(6), source=ScanMatch(),
    )  # fmt: skip
    pairs = [(6, 106), (5, 120), (30, 106)]
    assert untied(nodes, pairs, [closure], CONFIG) == pairs[1:]
    assert untied(nodes, pairs, [closure.judged(REJECTED)], CONFIG) == pairs
    assert (
        untied(nodes, pairs, [replace(closure, source=ImageMatch())], CONFIG) == pairs
    )  # by images: not as fine
