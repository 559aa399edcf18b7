"""Components of a broken path are joined where they fit in one way, and stay apart where in two."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from laser_rooms import WALLS, cast
from numpy.typing import NDArray
from sample_verdicts import REJECTED

from mapmyworld.config import Config
from mapmyworld.geometry.planar import (
    between_planar,
    compose_planar,
    invert_planar,
    planar_to_matrix,
)
from mapmyworld.places.component_maps import View, component_map
from mapmyworld.places.laser_closures import compare_places
from mapmyworld.places.laser_nodes import LaserNodes, NodeScans, nodes_at
from mapmyworld.places.session_joining import nearest_ends, reject_ambiguous_joins
from mapmyworld.places.wide_search import components_of, lost_pairs
from mapmyworld.registration.scan_matching import prepare_scan, scan_set
from mapmyworld.types import ConstraintKind, Judged, Node
from mapmyworld.types.wording import reason_of

CONFIG = Config()
Array = NDArray[np.float64]
HALL = np.array([[-5, -3, 5, -3], [5, -3, 5, 3], [5, 3, -5, 3], [-5, 3, -5, -3]], np.float64)
LENGTH = 750.0  # m of path that a loss counts for after which any heading is open
STRAIGHT = np.stack([np.linspace(-3.0, -1.0, 41), np.full(41, 1.0), np.zeros(41)], axis=-1)
TURNING = np.column_stack([np.tile(STRAIGHT[-1, :2], (20, 1)), np.linspace(0.15, 3.1, 20)])
AND_BACK = np.concatenate([STRAIGHT, TURNING, compose_planar([-4.0, 2.0, np.pi], STRAIGHT)])


def carried(walls: Array, *paths: Array, unseen: float = LENGTH) -> tuple[LaserNodes, NodeScans]:
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
    lost = np.zeros(len(truth))
    lost[np.cumsum([len(path) for path in paths])[:-1]] = unseen
    loaded = NodeScans(nodes, scan_set(scans), lost, np.ones(len(truth), np.bool_))
    return nodes_at(loaded, None), loaded


def found(walls: Array, *paths: Array) -> tuple[list[Judged], Array]:
    """Closures from each later place to each earlier component, and how far off each is (K, 3)."""
    nodes, _ = carried(walls, *paths)
    pairs = lost_pairs(nodes, [], CONFIG)
    tried = compare_places(nodes, pairs, CONFIG, optimised=False, widest=25.0)
    truth = np.concatenate(paths)
    wanted = [between_planar(truth[c.from_id - 1], truth[c.to_id - 1]) for c in tried]
    error = planar_to_matrix(np.array(wanted)) - np.stack([c.i_from_j for c in tried])
    return tried, np.abs(error).max(axis=(1, 2))


def judged(walls: Array, turn: float) -> Judged:
    """A closure from a robot's way back in a hall to where it was carried: true, or turned."""
    nodes, _ = carried(walls, AND_BACK, STRAIGHT)
    true = between_planar(AND_BACK[20], STRAIGHT[20])
    there = compose_planar([0.0, 0.0, turn], compose_planar(AND_BACK[20], true))
    wanted = planar_to_matrix(between_planar(AND_BACK[20], there))
    pair = (20, len(AND_BACK) + 20)
    given = replace(closure(pair[0] + 1, pair[1] + 1), i_from_j=wanted)
    return reject_ambiguous_joins(nodes, [pair], [given], CONFIG, 25.0)[0]


@pytest.mark.parametrize("turn", [0.0, np.pi])
def test_a_bare_hall_is_the_same_after_half_a_turn(turn: float) -> None:
    doubted = judged(HALL, turn)
    assert not doubted.accepted
    assert "fits as well" in reason_of(doubted)
    assert "180 deg" in reason_of(doubted)


def test_a_pillar_in_the_hall_distinguishes_its_ends() -> None:
    pillar = np.array([[1, 1.5, 3, 1.5], [3, 1.5, 3, -2], [3, -2, 1, -2], [1, -2, 1, 1.5]])
    walls = np.concatenate([HALL, pillar])
    assert judged(walls, 0.0).accepted
    assert not judged(walls, np.pi).accepted


@pytest.mark.parametrize("turn", [0.0, 1.0])
def test_rooms_that_differ_are_joined_in_any_heading(turn: float) -> None:
    later = STRAIGHT.copy()
    later[:, 2] += turn
    tried, error = found(WALLS, STRAIGHT, later)
    accepted = np.array([c.accepted for c in tried])
    assert accepted.any()
    assert error[accepted].max() < 0.03


def test_what_no_beam_passed_says_nothing_and_what_walls_hide_fits_nowhere() -> None:
    nodes, _ = carried(HALL, AND_BACK)
    made = component_map(nodes, np.arange(len(nodes.ids)))
    at_start = compose_planar(nodes.poses[0], invert_planar(AND_BACK[0]))  # of the hall's frame
    wall = np.column_stack([np.linspace(-4.0, 4.9, 90), np.full(90, 3.0)])
    view = View(wall, np.tile(AND_BACK[0, :2], (90, 1)))

    def fit(x: float, y: float) -> tuple[float, float]:
        score, seen = made.fit(view, compose_planar(at_start, [x, y, 0.0]))
        return round(score, 1), round(seen, 1)

    assert fit(0.0, 0.0) == (1.0, 1.0)
    assert fit(0.0, -1.0) == (0.0, 1.0)  # in what beams passed
    assert fit(0.0, 1.0) == (0.0, 1.0)  # behind the wall
    assert fit(0.0, 40.0)[1] == 0.0


def closure(a: int, b: int, *, accepted: bool = True) -> Judged:
    made = Judged(a, b, ConstraintKind.LOOP_CLOSURE, np.eye(4), np.eye(6))
    return made if accepted else made.judged(REJECTED)


def test_components_are_those_that_neither_wheels_nor_closures_tie() -> None:
    _, lost = carried(HALL, STRAIGHT, STRAIGHT, STRAIGHT)
    assert np.unique(components_of(lost, [])).tolist() == [0, 1, 2]
    assert len(np.unique(components_of(lost, [closure(3, 100)]))) == 2
    assert len(np.unique(components_of(lost, [closure(3, 100, accepted=False)]))) == 3
    assert len(np.unique(components_of(lost, [closure(3, 100), closure(50, 99)]))) == 1
    _, blind = carried(HALL, STRAIGHT, STRAIGHT, unseen=30.0)  # the wheels still indicate
    assert np.unique(components_of(blind, [])).tolist() == [0]


def test_how_far_two_parts_may_be_off_is_said_by_the_least_way_between_them() -> None:
    """Components that closures joined may surround another one, before it and after it."""
    nodes, _ = carried(HALL, STRAIGHT, STRAIGHT, STRAIGHT)
    around = replace(nodes, component=np.where(nodes.component == 1, 1, 0))
    assert nearest_ends(nodes, 0, 100) == (40, 82)
    assert nearest_ends(around, 0, 60) in ((40, 41), (81, 82))
    assert nearest_ends(around, 60, 100) in ((40, 41), (81, 82))


def test_of_closures_that_contradict_each_other_the_ones_that_more_supports_stay() -> None:
    nodes, _ = carried(WALLS, AND_BACK, STRAIGHT)
    pairs = [(20, len(AND_BACK) + 20), (22, len(AND_BACK) + 22), (24, len(AND_BACK) + 24)]
    true = [between_planar(AND_BACK[a], STRAIGHT[b - len(AND_BACK)]) for a, b in pairs]
    wanted = [true[0], true[1], compose_planar(true[2], [0.0, 0.0, np.pi])]
    given = [
        replace(closure(a + 1, b + 1), i_from_j=planar_to_matrix(pose))
        for (a, b), pose in zip(pairs, wanted, strict=True)
    ]
    doubted = reject_ambiguous_joins(nodes, pairs, given, CONFIG, 25.0)
    assert [c.accepted for c in doubted] == [True, True, False]
    assert "explains more" in reason_of(doubted[2])


def test_where_wheels_indicate_the_heading_nothing_is_doubted_here() -> None:
    nodes, _ = carried(HALL, AND_BACK, STRAIGHT, unseen=100.0)
    given = closure(21, len(AND_BACK) + 21)
    pair = (20, len(AND_BACK) + 20)
    assert reject_ambiguous_joins(nodes, [pair], [given], CONFIG, 25.0) == [given]
