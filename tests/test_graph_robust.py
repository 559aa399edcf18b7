"""Which closures are believed: chances, groups that agree, components left alone."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from mapmyworld.backend.descent import optimised_roughly
from mapmyworld.backend.system import edge_chi2
from mapmyworld.config import GraphConfig
from mapmyworld.geometry.planar import between_planar, compose_planar
from mapmyworld.graph.clusters import chance_of, judge_groups
from mapmyworld.graph.inlier_recovery import expected_below
from mapmyworld.graph.optimisation import optimise, optimise_robustly
from mapmyworld.graph.problem import problem_of
from mapmyworld.graph.robust import _afresh, _Found, _Question
from mapmyworld.types.pose_graph import Edges, PoseGraph, Sightings, no_priors, no_sightings

SIGMA = np.array([0.03, 0.03, 0.01])
PLAIN = GraphConfig(certify=False)
ROUND = 500  # nodes


def lawn(rows: int = 8, length: int = 15) -> np.ndarray:
    """True poses (N, 3) of a robot that mows a lawn, a metre a step, and then across its rows."""
    there = [
        (x, y) for y in range(rows) for x in (range(length) if y % 2 == 0 else range(length)[::-1])
    ]
    across = [
        (x, y) for x in range(length)[::-1] for y in (range(rows)[::-1] if x % 2 else range(rows))
    ]
    places = np.array(there + across, np.float64)
    heading = np.append(np.arctan2(*np.diff(places, axis=0).T[::-1]), 0.0)
    return np.column_stack([places, heading])


def drive(truth: np.ndarray, pairs: np.ndarray, seed: int = 0) -> PoseGraph:
    """A noisy graph of a drive with closures between pairs (P, 2) of nodes."""
    rng, count = np.random.default_rng(seed), len(truth)
    chain = np.column_stack([np.arange(count - 1), np.arange(1, count)])
    ends = np.concatenate([chain, pairs])
    noise = rng.normal(size=(len(ends), 3)) * SIGMA
    measured = compose_planar(between_planar(truth[ends[:, 0]], truth[ends[:, 1]]), noise)
    information = np.tile(np.diag(SIGMA**-2.0), (len(ends), 1, 1))
    odometry = np.arange(len(ends)) < count - 1
    return PoseGraph(
        True,
        np.arange(count),
        np.zeros((count, 3)),
        Edges(ends[:, 0], ends[:, 1], measured, information, odometry),
        landmarks=np.zeros((0, 2)),
        sightings=no_sightings(True),
        priors=no_priors(True),
    )


def meetings(truth: np.ndarray) -> np.ndarray:
    """Pairs of nodes at the same place, long apart."""
    apart = np.linalg.norm(truth[:, None, :2] - truth[None, :, :2], axis=2)
    tails, heads = np.nonzero(apart < 0.1)
    return np.column_stack([tails, heads])[heads - tails > 20]


def with_corridors(graph: PoseGraph, truth: np.ndarray, groups: int, size: int) -> PoseGraph:
    """The graph with groups of false closures, each consistent with itself and with odometry."""
    rng, edges = np.random.default_rng(5), graph.edges
    tails, heads, motions = [], [], []
    for _ in range(groups):
        a, b = (
            rng.integers(0, len(truth) // 2 - size),
            rng.integers(len(truth) // 2, len(truth) - size),
        )
        base = np.array([*rng.uniform(-4.0, 4.0, 2), rng.uniform(-np.pi, np.pi)])
        for k in range(size):
            back = between_planar(truth[a + k], truth[a])
            seen = compose_planar(
                compose_planar(back, base), between_planar(truth[b], truth[b + k])
            )
            tails.append(a + k)
            heads.append(b + k)
            motions.append(seen)
    count = len(tails)
    return replace(
        graph,
        edges=Edges(
            np.concatenate([edges.from_ids, tails]),
            np.concatenate([edges.to_ids, heads]),
            np.concatenate([edges.i_from_j, motions]),
            np.concatenate([edges.information, np.tile(np.diag(SIGMA**-2.0), (count, 1, 1))]),
            np.concatenate([edges.odometry, np.zeros(count, np.bool_)]),
        ),
    )


@pytest.mark.parametrize("size", [2, 5, 10])
def test_groups_of_false_closures_that_agree_among_themselves_are_rejected(size):
    truth = lawn()
    graph = drive(truth, meetings(truth))
    clean = optimise(graph, PLAIN)
    mixed = with_corridors(graph, truth, 40 // size, size)
    solved = optimise_robustly(mixed, PLAIN)
    true = np.arange(len(mixed.edges)) < len(graph.edges)
    assert not solved.accepted[~true].any()
    assert solved.accepted[true].mean() > 0.99
    assert solved.squared_sigmas[true].sum() < 1.01 * clean.squared_sigmas.sum()


@pytest.mark.parametrize("size", [20, 100])
def test_a_group_is_judged_however_large_it_is(size: int) -> None:
    """Closures that shift two stretches by 0.3 m against all others, and agree on it."""
    truth = lawn()
    true = drive(truth, meetings(truth))
    mixed = with_corridors(true, truth, 1, size)
    shifted = mixed.edges.i_from_j.copy()
    false = np.arange(size) + len(true.edges)
    tails, heads = mixed.edges.from_ids[false], mixed.edges.to_ids[false]
    shifted[false] = between_planar(truth[tails], truth[heads]) + np.array([0.3, 0, 0])
    problem = problem_of(replace(mixed, edges=replace(mixed.edges, i_from_j=shifted)))
    every = np.ones(len(mixed.edges), np.bool_)
    closures = np.flatnonzero(problem.order >= len(truth) - 1)
    is_false = problem.order[closures] >= len(true.edges)
    groups = np.where(is_false, 0, 1 + np.arange(len(closures)) // 4)
    poses = optimised_roughly(problem.system, np.vstack([truth, np.zeros(3)]))
    found = judge_groups(problem.system, poses, every, closures, groups, PLAIN.inlier_probability)
    worst = int(np.argmax(found.excess))
    assert found.excess[worst] > 1.0
    assert np.array_equal(np.sort(problem.order[found.members[worst]]), false)


def test_a_group_within_what_it_states_stays_beside_groups_that_fit_better() -> None:
    """All closures state 2 m; those of one group are off by 2 m, the others by 3 cm."""
    truth = lawn()
    graph = drive(truth, meetings(truth))
    stated, measured = graph.edges.information.copy(), graph.edges.i_from_j.copy()
    closures = np.flatnonzero(~graph.edges.odometry)
    stated[closures] = np.diag(np.array([2.0, 2.0, 0.5]) ** -2.0)
    off = closures[: len(closures) // 4]
    measured[off] = compose_planar(measured[off], np.array([2.0, 0.0, 0.0]))
    edges = replace(graph.edges, information=stated, i_from_j=measured)
    problem = problem_of(replace(graph, edges=edges))
    asked = np.flatnonzero(problem.order >= len(truth) - 1)
    is_off = np.isin(problem.order[asked], off)
    groups = np.where(is_off, 0, 1 + np.arange(len(asked)) // 8)
    every = np.ones(len(measured), np.bool_)
    poses = optimised_roughly(problem.system, np.vstack([truth, np.zeros(3)]))
    found = judge_groups(problem.system, poses, every, asked, groups, PLAIN.inlier_probability)
    assert found.scale < 0.05
    assert (found.excess < 0.5).all()


def test_a_closure_that_alone_corrects_a_drift_is_recovered():
    """One closure at the end of a long drive misses what odometry indicates by metres, within what
    odometry allows; nothing else supports it, and nothing looks false.
    """
    count = 400
    angle = 2 * np.pi * np.arange(count) / (count - 1)
    truth = np.column_stack([60 * np.cos(angle), 60 * np.sin(angle), angle + np.pi / 2])
    graph = drive(truth, np.array([[0, count - 1]]), seed=3)
    solved = optimise_robustly(graph, PLAIN)
    assert solved.accepted.all()
    assert solved.cost == pytest.approx(optimise(graph, PLAIN).cost, rel=1e-6)


def test_what_nothing_predicts_is_not_recovered_and_the_parts_are_solved():
    """Odometry breaks in the middle; one lone closure joins the halves, nothing speaks for it."""
    truth = lawn(4, 10)
    graph = drive(truth, np.array([[3, 70]]))
    broken = np.arange(len(graph.edges)) != len(truth) // 2
    solved = optimise_robustly(
        replace(graph, edges=graph.edges.chosen(np.flatnonzero(broken))), PLAIN
    )
    assert np.isfinite(solved.graph.map_from_node).all()
    assert solved.accepted[:-1].all()
    assert solved.cost < 1e-6


@pytest.mark.parametrize("freedom", [3, 6])
def test_the_chance_of_a_false_fit_is_the_share_of_its_ellipsoid(freedom):
    """Alternatives uniform in a cube, a prediction in its midst: the share is counted."""
    rng = np.random.default_rng(1)
    side, spread = 8.0, 1.5
    drawn = rng.uniform(-side / 2, side / 2, (200_000, freedom))
    fit = np.array([4.0])
    share = np.mean(np.sum((drawn / spread) ** 2, axis=1) <= fit[0])
    volume = np.array([(2.0 * np.pi) ** (freedom / 2) * spread**freedom])
    found = chance_of(fit, volume, freedom * np.log(side), freedom)
    assert found[0] == pytest.approx(share, rel=0.05)


def test_expected_false_fits_are_those_that_a_simulation_counts():
    rng = np.random.default_rng(2)
    most = rng.uniform(0.0, 0.3, 50)
    # A false closure fits by a uniform chance, or not at all where that is beyond its most.
    drawn = rng.random((20_000, 50))
    for chance in (0.01, 0.1, 0.5):
        counted = np.mean(np.sum(drawn <= np.minimum(chance, most), axis=1))
        assert expected_below(np.array([chance]), most)[0] == pytest.approx(counted, rel=0.05)


def test_a_landmark_seen_once_by_bearing_alone_stops_nothing():
    """No covariance exists for it; the closures are judged all the same."""
    truth = lawn()
    graph = drive(truth, meetings(truth))
    bearing = Sightings(
        np.array([3]),
        np.array([900]),
        np.array([[0.5, 0.0]]),
        np.diag([400.0, 0.0])[None],
        np.array([True]),
    )
    seen = replace(
        graph, landmark_ids=np.array([900]), landmarks=np.array([[5.0, 5.0]]), sightings=bearing
    )
    solved = optimise_robustly(seen, PLAIN)
    assert solved.accepted.mean() > 0.9
    assert np.isfinite(solved.graph.map_from_node).all()


def test_what_false_closures_have_bent_does_not_stay_bent() -> None:
    """A ring wound once too often is a minimum; that of a fresh start costs a fraction."""
    angle = 2 * np.pi * np.arange(40) / 40
    truth = np.column_stack([np.cos(angle) * 6, np.sin(angle) * 6, angle])
    graph = drive(truth, np.array([[39, 0]]))
    problem = problem_of(graph)
    system, every = problem.system, np.ones(len(graph.edges), np.bool_)
    trusted = graph.edges.odometry[problem.order]
    closures = np.flatnonzero(~trusted)
    question = _Question(system, trusted, closures, np.zeros(1, np.int64), 30.0, PLAIN)
    wound = np.zeros((41, 3))
    wound[:40, 2] = 2 * angle
    bent = optimised_roughly(system, wound, 1e-9, 100)
    best = optimise(graph).cost
    assert edge_chi2(system, bent).sum() > 10 * best
    found = _Found(bent, every, True)
    fresh = _afresh(question, problem.guess, problem.anchors, found)
    assert fresh.inliers.all()
    assert 0.5 * edge_chi2(system, fresh.poses).sum() == pytest.approx(best, rel=1e-3)
    assert _afresh(question, problem.guess, problem.anchors, fresh) is fresh


def two_rounds(pairs: np.ndarray, seed: int = 4) -> PoseGraph:
    """A round of 500 m driven twice, a metre a step: the second is badly known by odometry."""
    angle = 2 * np.pi * np.arange(2 * ROUND) / ROUND
    radius = ROUND / (2 * np.pi)
    truth = np.column_stack([radius * np.cos(angle), radius * np.sin(angle), angle + np.pi / 2])
    return drive(truth, pairs, seed)


def with_strangers(graph: PoseGraph, count: int) -> PoseGraph:
    """The graph with false closures of random nodes, places and headings."""
    rng, edges = np.random.default_rng(7), graph.edges
    tails = rng.integers(0, ROUND, count)
    places = rng.uniform(-20, 20, (count, 2))
    motions = np.column_stack([places, rng.uniform(-np.pi, np.pi, count)])
    return graph.__class__(
        True,
        graph.ids,
        graph.map_from_node,
        edges.__class__(
            np.concatenate([edges.from_ids, tails]),
            np.concatenate([edges.to_ids, tails + ROUND]),
            np.concatenate([edges.i_from_j, motions]),
            np.concatenate([edges.information, np.tile(np.diag(SIGMA**-2.0), (count, 1, 1))]),
            np.concatenate([edges.odometry, np.zeros(count, np.bool_)]),
        ),
        landmarks=graph.landmarks,
        sightings=graph.sightings,
        priors=graph.priors,
    )


SECTIONS = [(k, k + ROUND) for start in (50, 70, 90, 110) for k in range(start, start + 8)]


def test_a_second_round_is_joined_to_the_first_among_many_false_closures() -> None:
    graph = with_strangers(two_rounds(np.array(SECTIONS)), 300)
    solved = optimise_robustly(graph, PLAIN)
    true = np.arange(len(graph.edges)) < len(graph.edges) - 300
    assert np.array_equal(solved.accepted, true)
