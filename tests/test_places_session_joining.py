"""Sessions that tracking losses divide: joined where they fit in one way, apart where in two."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from laser_rooms import WALLS, cast
from numpy.typing import NDArray
from sample_verdicts import REJECTED

from mapmyworld.api import Silent
from mapmyworld.config import Config
from mapmyworld.geometry.planar import (
    between_planar,
    compose_planar,
    information_from_planar,
    invert_planar,
    matrix_to_planar,
    planar_to_matrix,
)
from mapmyworld.places.laser_nodes import LaserNodes, NodeScans, joined_sessions, nodes_at
from mapmyworld.places.session_closures import session_closures
from mapmyworld.places.session_joining import (
    LossPrior,
    find_joints,
    judge_pose,
    locate_session,
)
from mapmyworld.places.session_places import SessionPlaces
from mapmyworld.places.whole_map import map_of_scans
from mapmyworld.registration.place_evidence import Agreement, Place
from mapmyworld.registration.scan_matching import prepare_scan, scan_set
from mapmyworld.registration.submaps import Submap
from mapmyworld.types import ConstraintKind, Judged, Node

CONFIG = Config()
Array = NDArray[np.float64]
HALL = np.array([[-5, -3, 5, -3], [5, -3, 5, 3], [5, 3, -5, 3], [-5, 3, -5, -3]], np.float64)
STRAIGHT = np.stack([np.linspace(-3.0, -1.0, 41), np.full(41, 1.0), np.zeros(41)], axis=-1)
TURNING = np.column_stack([np.tile(STRAIGHT[-1, :2], (20, 1)), np.linspace(0.15, 3.1, 20)])
AND_BACK = np.concatenate([STRAIGHT, TURNING, compose_planar([-4.0, 2.0, np.pi], STRAIGHT)])


def carried(walls: Array, *paths: Array) -> tuple[LaserNodes, NodeScans]:
    """Nodes of a robot that is carried from path to path, each time turned by 40 degrees."""
    truth = np.concatenate(paths)
    begin = [
        compose_planar([0.3, 0.1, np.radians(40.0) * k], path[0]) for k, path in enumerate(paths)
    ]
    believed = np.concatenate(
        [
            compose_planar(at, between_planar(path[0], path))
            for at, path in zip(begin, paths, strict=True)
        ]
    )
    scans = [prepare_scan(cast(p, walls, k), CONFIG.registration) for k, p in enumerate(truth)]
    nodes = [Node(k + 1, 0, k, p, p) for k, p in enumerate(planar_to_matrix(believed))]
    lost = np.zeros(len(truth), np.bool_)
    lost[np.cumsum([len(path) for path in paths])[:-1]] = True
    sees = np.ones(len(truth), np.bool_)
    loaded = NodeScans(nodes, scan_set(scans), lost, sees, ~sees)
    return nodes_at(loaded, None, None, _motions(believed, lost)), loaded


def _motions(poses: Array, lost: NDArray[np.bool_]) -> list[Judged]:
    """Between nodes with ids from 1 on at poses (N, 3), but for those where tracking was lost."""
    steps = planar_to_matrix(between_planar(poses[:-1], poses[1:]))
    known = information_from_planar(np.diag([1e8, 1e8, 1e8]))
    return [
        Judged(k, k + 1, ConstraintKind.NEIGHBOUR, step, known)
        for k, step in enumerate(steps, start=1)
        if not lost[k]
    ]


def with_loss(nodes: LaserNodes, variances: Array) -> LaserNodes:
    """The same, and how the one session leads to the other, with such variances (3,)."""
    ends = np.flatnonzero(np.diff(nodes.session))[0] + [0, 1]
    motion = planar_to_matrix(between_planar(*nodes.poses[ends]))
    known = information_from_planar(np.diag(1.0 / variances))
    loss = Judged(*nodes.ids[ends].tolist(), ConstraintKind.NEIGHBOUR, motion, known)
    return replace(nodes, drift=replace(nodes.drift, stated=(*nodes.drift.stated, loss)))


def after_loss(nodes: LaserNodes, variances: Array) -> LossPrior:
    """Of the second session, by a loss of such variances (3,)."""
    maps = [SessionPlaces(nodes, np.flatnonzero(nodes.session == k), CONFIG) for k in (0, 1)]
    return LossPrior(with_loss(nodes, variances).drift, *maps)


def located(walls: Array, *paths: Array, prior: LossPrior | None = None) -> Array | None:
    """Where the second session lies in the first (3,), each in a frame of its own."""
    nodes, _ = carried(walls, *paths)
    maps = [SessionPlaces(nodes, np.flatnonzero(nodes.session == k), CONFIG) for k in (0, 1)]
    return locate_session(*maps, prior)


def miss(move: Array, walls: Array, *paths: Array) -> Array:
    """(2,) metres and radians at the second session's first node."""
    nodes, _ = carried(walls, *paths)
    first = len(paths[0])
    there = between_planar(nodes.poses[0], compose_planar(move, nodes.poses[first]))
    off = between_planar(between_planar(paths[0][0], paths[1][0]), there)
    return np.array([np.hypot(*off[:2]), abs(off[2])])


def test_one_wall_that_agrees_speaks_for_no_place_and_a_corner_does() -> None:
    along = np.arange(0.0, 8.0, 0.05)
    wall = np.stack([along, np.zeros_like(along)], axis=-1)
    corner = np.concatenate([wall, wall[:80, ::-1]])
    for points, is_evidence in ((wall, False), (corner, True)):
        seen = Submap(points, np.array([[4.0, 2.0]]), np.array([0, len(points)]))
        found = map_of_scans(seen).judge(Place.of(seen), np.zeros(3))
        assert found.known == 1.0
        assert found.evidence > 100.0
        assert (found.log_odds > 20.0) == is_evidence
        assert (found.log_odds == 0.0) != is_evidence


@pytest.mark.parametrize("path", [STRAIGHT, AND_BACK])
def test_a_bare_hall_is_the_same_after_half_a_turn(path: Array) -> None:
    assert located(HALL, AND_BACK, path) is None


def test_the_two_ends_of_a_bare_hall_may_be_one() -> None:
    """Each drive has one end wall in sight: what both poses know are the walls along the hall."""
    one = np.stack([np.linspace(-3.0, 3.0, 81), np.ones(81), np.zeros(81)], axis=-1)
    opposite = one[::-1] + np.array([0.3, 0.0, np.pi])
    assert located(HALL, one, opposite) is None


def test_half_a_turn_is_none_where_the_loss_was_too_short_for_it() -> None:
    """Of two poses that look alike one lies 6 m and half a turn from where the path ended."""
    nodes, _ = carried(HALL, AND_BACK, STRAIGHT)
    for sigma, is_found in ((5.0, False), (0.5, True)):
        prior = after_loss(nodes, np.array([9.0, 9.0, sigma**2]))
        move = located(HALL, AND_BACK, STRAIGHT, prior=prior)
        assert (move is not None) == is_found
        if move is not None:
            assert (miss(move, HALL, AND_BACK, STRAIGHT) < [0.1, 0.02]).all()


def test_a_pose_that_the_loss_rules_out_hides_none_that_it_allows() -> None:
    """Half a turn away the place fits as well, in a corner of the window but too far off."""
    later = STRAIGHT[:31] + np.array([0.8, -2.5, 0.0])
    nodes, _ = carried(HALL, AND_BACK, later)
    prior = after_loss(nodes, np.array([1.4, 1.4, 25.0]))
    move = located(HALL, AND_BACK, later, prior=prior)
    assert move is not None
    assert (miss(move, HALL, AND_BACK, later) < [0.1, 0.02]).all()


def test_a_pillar_in_the_hall_leaves_one_pose() -> None:
    pillar = np.array([[1, 1.5, 3, 1.5], [3, 1.5, 3, -2], [3, -2, 1, -2], [1, -2, 1, 1.5]])
    walls = np.concatenate([HALL, pillar])
    move = located(walls, AND_BACK, STRAIGHT)
    assert move is not None
    assert (miss(move, walls, AND_BACK, STRAIGHT) < [0.1, 0.02]).all()


@pytest.mark.parametrize("turn", [0.0, 1.0])
def test_rooms_that_differ_are_joined_in_any_heading(turn: float) -> None:
    later = STRAIGHT.copy()
    later[:, 2] += turn
    nodes, _ = carried(WALLS, STRAIGHT, later)
    nodes = with_loss(nodes, np.full(3, 25.0))
    accepted = [c for c in session_closures(nodes, CONFIG, Silent(), set()) if c.accepted]
    assert accepted
    truth = np.concatenate([STRAIGHT, later])
    for c in accepted:
        assert c.kind == ConstraintKind.LOOP_CLOSURE
        wanted = between_planar(truth[c.from_id - 1], truth[c.to_id - 1])
        off = between_planar(wanted, matrix_to_planar(c.i_from_j))
        assert np.abs(off).max() < 0.03


def test_what_lies_beside_a_map_does_not_join_it() -> None:
    """A hall whose wall could lie on the outer wall of another one, seen from its other side."""
    wide = HALL * 1.7
    one, _ = carried(HALL, AND_BACK)
    other, _ = carried(wide, AND_BACK)
    maps = [SessionPlaces(n, np.arange(len(n.ids)), CONFIG) for n in (one, other)]
    assert locate_session(*maps) is None
    assert locate_session(*reversed(maps)) is None


def test_a_corner_seen_from_its_other_side_is_another_one() -> None:
    """The corner of a block that one robot goes round, and that of a room as large."""
    along = np.arange(0.05, 6.0, 0.05)
    corner = np.concatenate(
        [np.stack([along, 0.0 * along], axis=-1), np.stack([0.0 * along, along], axis=-1)]
    )
    inside, outside = (
        Submap(corner, np.array([[at, at]]), np.array([0, len(corner)])) for at in (2.0, -2.0)
    )
    whole = map_of_scans(inside)
    same, other = (whole.judge(Place.of(s), np.zeros(3)) for s in (inside, outside))
    assert same.known > 0.9
    assert same.log_odds > 20.0
    assert other.known < 0.1
    assert other.log_odds == 0.0
    one, another = Place.of(inside), Place.of(outside)
    assert one.agreement_with(one, np.zeros(3)).evidence > 100.0
    assert one.agreement_with(another, np.zeros(3)).evidence < 20.0


def test_a_relative_pose_is_as_likely_whichever_session_is_called_the_earlier() -> None:
    nodes, _ = carried(WALLS, AND_BACK, STRAIGHT)
    one, other = (SessionPlaces(nodes, np.flatnonzero(nodes.session == k), CONFIG) for k in (0, 1))
    move = locate_session(one, other)
    assert move is not None
    spot = other.sought[0]
    there = judge_pose(one, other, move, nodes.poses[spot])
    about = compose_planar(move, nodes.poses[spot])
    same = int(one.rows[np.argmin(np.hypot(*(nodes.poses[one.rows] - about).T[:2]))])
    again = judge_pose(other, one, invert_planar(move), nodes.poses[same])
    assert again.log_odds == pytest.approx(there.log_odds, rel=0.05)
    assert set(again.later) == set(there.earlier)


def test_a_pose_is_another_one_where_places_lie_elsewhere() -> None:
    """A little apart, both are moved to the same poses by what the sessions may have drifted."""
    nodes, _ = carried(WALLS, AND_BACK, STRAIGHT)
    one, other = (SessionPlaces(nodes, np.flatnonzero(nodes.session == k), CONFIG) for k in (0, 1))
    about = nodes.poses[other.sought[0]]
    move = locate_session(one, other)
    assert move is not None
    best, beside, behind = (
        judge_pose(one, other, compose_planar(move, off), about)
        for off in ([0.0, 0.0, 0.0], [0.05, 0.1, 0.01], [1.5, 0.0, 0.0])
    )
    assert best.is_same(beside)
    assert best.refutes(behind) > 20.0
    assert not best.is_same(behind)


def test_odds_weigh_a_miss_more_than_a_hit() -> None:
    """Another building's corridor explains three points of four as well."""
    many, none = np.ones(100, np.int64), np.zeros(0, np.int64)
    assert Agreement(many, none).log_odds > 20.0
    corridor = many.copy()
    corridor[:25] = -1
    assert Agreement(corridor, none).log_odds < 0.0
    assert Agreement(np.zeros(100, np.int64), none).log_odds == 0.0
    assert Agreement(np.zeros(100, np.int64), none).known == 0.0


def test_each_session_is_tied_to_one_of_each_group_it_belongs_to() -> None:
    near = {(0, 1), (0, 2), (1, 2), (3, 4), (2, 4)}
    joints = find_joints(5, lambda a, b: np.zeros(3) if (a, b) in near else None)
    assert list(joints) == [(0, 1), (0, 2), (2, 4), (3, 4)]


def closure(a: int, b: int, *, accepted: bool = True) -> Judged:
    made = Judged(a, b, ConstraintKind.LOOP_CLOSURE, np.eye(4), np.eye(6))
    return made if accepted else made.judged(REJECTED)


def test_sessions_are_one_that_closures_join_and_end_where_nothing_reports_the_motion() -> None:
    _, lost = carried(HALL, STRAIGHT, STRAIGHT, STRAIGHT)
    assert np.unique(joined_sessions(lost, [])).tolist() == [0, 1, 2]
    assert len(np.unique(joined_sessions(lost, [closure(3, 100)]))) == 2
    assert len(np.unique(joined_sessions(lost, [closure(3, 100, accepted=False)]))) == 3
    assert len(np.unique(joined_sessions(lost, [closure(3, 100), closure(50, 99)]))) == 1


def hall_of(narrower: float, moved: float) -> Array:
    """A hall of 20 m, from x = 3 on `narrower` by so much on both sides; a pillar may be moved."""
    y, end = 3.0 - narrower, 15.0 - narrower
    outline = [[-5, -3, 3, -3], [3, -3, 3, -y], [3, -y, end, -y], [end, -y, end, y],
               [end, y, 3, y], [3, y, 3, 3], [3, 3, -5, 3], [-5, 3, -5, -3]]  # fmt: skip
    for x, at in ((-3.0, -2.2), (-0.5, 1.6), (1.5, -1.9), (7.0 + moved, 1.0), (11.0, -1.5)):
        right, above = x + 0.8, at + 0.5
        outline += [[x, at, right, at], [right, at, right, above], [right, above, x, above],
                    [x, above, x, at]]  # fmt: skip
    return np.array(outline, np.float64)


@pytest.mark.parametrize(
    ("narrower", "moved", "is_one"), [(0.0, 0.0, True), (0.0, 2.0, True), (0.8, 0.0, False)]
)
def test_buildings_that_share_one_end_are_not_one(
    narrower: float, moved: float, is_one: bool
) -> None:
    path = np.stack([np.linspace(-4.0, 13.0, 171), np.zeros(171), np.zeros(171)], axis=-1)
    back = np.array([0.0, 0.2, np.pi])
    drives = ((hall_of(0.0, 0.0), path), (hall_of(narrower, moved), path[::-1] + back))
    maps = []
    for walls, drive in drives:
        nodes, _ = carried(walls, drive)
        maps.append(SessionPlaces(nodes, np.arange(len(nodes.ids)), CONFIG))
    assert (locate_session(*maps) is not None) == is_one
