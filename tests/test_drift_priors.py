"""Where places lie before their scans are compared, as the graph knows it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray

from mapmyworld.geometry.planar import (
    between_planar,
    compose_planar,
    information_from_planar,
    planar_to_matrix,
)
from mapmyworld.odometry.pose_hypotheses import FAULT_SIZE
from mapmyworld.places.doubted_odometry import in_doubt
from mapmyworld.places.drift_priors import drift_priors
from mapmyworld.places.laser_candidates import SLACK
from mapmyworld.places.laser_nodes import LaserNodes, laser_nodes
from mapmyworld.places.node_drift import NodeDrift
from mapmyworld.registration.scan_matching import scan_set
from mapmyworld.types import ConstraintKind, Judged, LaserTracking

METRES, RADIANS = 0.05, 0.01


def motion(poses: NDArray[np.float64], a: int, b: int) -> Judged:
    """As the poses (N, 3) have it, known to `METRES` and `RADIANS`."""
    information = np.diag(np.array([METRES, METRES, RADIANS]) ** -2.0)
    return Judged(
        a, b, ConstraintKind.NEIGHBOUR, planar_to_matrix(between_planar(poses[a], poses[b])),
        information_from_planar(information),
    )  # fmt: skip


def nodes_of(poses: NDArray[np.float64]) -> LaserNodes:
    """Nodes at poses (N, 3), by motions from each to the next one."""
    ids = np.arange(len(poses), dtype=np.int64)
    return laser_nodes(
        ids, scan_set([]), poses, [motion(poses, k, k + 1) for k in ids[:-1].tolist()]
    )


def test_a_straight_way_leaves_its_sides_more_open_than_its_length() -> None:
    """Headings swing the end by their distance from it, across the way and not along."""
    poses = np.stack([np.arange(41.0), np.zeros(41), np.zeros(41)], axis=-1)
    (prior,) = drift_priors(nodes_of(poses), [(0, 40)])
    along = 40.0 * METRES**2 + (SLACK[0] / 3.0) ** 2
    across = along + RADIANS**2 * sum(k * k for k in range(40))
    turned = 40.0 * RADIANS**2 + (SLACK[1] / 3.0) ** 2
    np.testing.assert_allclose(prior.covariance.diagonal(), [along, across, turned], rtol=1e-6)
    np.testing.assert_allclose(prior.pose, [40.0, 0.0, 0.0])
    ahead, aside = (prior.log(np.array([40.0 + x, y, 0.0])) for x, y in ((1.0, 0.0), (0.0, 1.0)))
    assert ahead < 2.0 * aside < 0.0
    metres, radians = prior.window(np.inf)
    assert metres == pytest.approx(3.0 * np.sqrt(across))
    assert radians == pytest.approx(3.0 * np.sqrt(turned))
    assert prior.window(2.0)[0] == 2.0


def test_two_ways_between_places_are_better_than_the_better_one() -> None:
    turn = np.array([1.0, 0.0, 2.0 * np.pi / 40])
    poses = [np.zeros(3)]
    for _ in range(39):
        poses.append(compose_planar(poses[-1], turn))
    ring = nodes_of(np.stack(poses))
    closed = replace(ring, drift=held_by(ring.drift, motion(ring.poses, 39, 0)))
    one, both = (drift_priors(nodes, [(0, 20)])[0].covariance for nodes in (ring, closed))
    least = np.diag([SLACK[0], *SLACK]) ** 2 / 9.0
    assert np.linalg.eigvalsh(both - least).max() < 0.6 * np.linalg.eigvalsh(one - least).max()


def held_by(drift: NodeDrift, *more: Judged) -> NodeDrift:
    return replace(drift, stated=(*drift.stated, *more))


def in_one_place() -> NodeDrift:
    """A hundred motions that lead nowhere, so that no heading swings anything."""
    return nodes_of(np.zeros((101, 3))).drift


def motions(drift: NodeDrift, a: int, b: int) -> float:
    """How many motions what may have drifted between two nodes is worth."""
    metres, _ = drift.reach(np.array([a]), np.array([b]))[0]
    return float(np.square(metres / (3.0 * METRES)))


def joint(a: int, b: int) -> Judged:
    """A closure that shows exactly that two nodes are at one pose."""
    return Judged(a, b, ConstraintKind.LOOP_CLOSURE, np.eye(4), 1e12 * np.eye(6))


def test_what_the_graph_does_not_connect_may_lie_anywhere() -> None:
    poses = np.stack([np.arange(41.0), np.zeros(41), np.zeros(41)], axis=-1)
    nodes = nodes_of(poses)
    motions = nodes.drift.stated
    parted = replace(nodes, drift=replace(nodes.drift, stated=motions[:20] + motions[21:]))
    known, unknown = drift_priors(parted, [(0, 20), (0, 40)])
    whole, _ = drift_priors(nodes, [(0, 20), (0, 40)])
    np.testing.assert_allclose(known.covariance, whole.covariance)
    metres, radians = unknown.window(np.inf)
    assert metres > 1000.0
    assert radians == np.pi
    assert drift_priors(nodes, []) == []


def test_what_is_left_undetermined_may_lie_anywhere() -> None:
    nothing = Judged(3, 4, ConstraintKind.NEIGHBOUR, np.eye(4), np.zeros((6, 6)))
    drift = replace(in_one_place(), stated=(nothing,))
    assert motions(drift, 3, 4) > (1000.0 / 3.0 / METRES) ** 2


def test_a_closure_holds_what_it_joins_and_not_the_path_before() -> None:
    """One between 60 and 70 leaves 90 as far from the start as the other 80 motions do."""
    drift = in_one_place()
    held = held_by(drift, joint(60, 70))
    assert motions(drift, 0, 90) == pytest.approx(90.0)
    assert motions(held, 0, 90) == pytest.approx(80.0, rel=1e-3)
    # From 65 two ways of five motions lead to one place.
    for a, count in ((60, 1.0), (65, 3.5), (0, 61.0), (95, 24.0)):
        assert motions(held, a, 71) == pytest.approx(count, rel=1e-3)
    assert motions(held, 7, 7) == 0.0


def test_odometry_in_doubt_is_looked_beyond_until_a_closure_spans_it() -> None:
    drift = in_one_place()
    source = LaserTracking("odometry only", 0.0)
    doubted = in_doubt(replace(drift.stated[49], source=source), True)
    drift = replace(drift, stated=(*drift.stated[:49], doubted, *drift.stated[50:]))
    faults = replace(drift, faults=True)
    assert motions(drift, 40, 60) == pytest.approx(20.0)
    assert motions(faults, 40, 60) == pytest.approx(20.0 + (FAULT_SIZE[0] / METRES) ** 2)
    assert motions(faults, 10, 45) == pytest.approx(35.0)
    for ends, spans in (((10, 50), True), ((49, 90), True), ((50, 90), False), ((10, 49), False)):
        assert (motions(held_by(faults, joint(*ends)), 40, 60) < 60.0) == spans


def test_longer_submaps_are_as_certain_as_the_motions_within_them() -> None:
    poses = np.stack([np.arange(41.0), np.zeros(41), np.zeros(41)], axis=-1)
    drift = nodes_of(poses).drift
    moved, _, turned = drift.within([(20, np.array([10, 20, 30]))]).diagonal()
    assert turned == pytest.approx(RADIANS**2 * 20.0 / 3.0)
    swung = RADIANS**2 * (sum(k * k for k in range(10)) + sum(k * k for k in range(1, 11)))
    assert 2.0 * moved == pytest.approx((40.0 * METRES**2 + swung) / 3.0)
    twice = drift.within([(20, np.array([10, 20, 30]))] * 2)
    np.testing.assert_allclose(twice.diagonal(), 2.0 * np.array([moved, moved, turned]))
