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
from mapmyworld.places.drift_priors import drift_priors
from mapmyworld.places.laser_candidates import SLACK
from mapmyworld.places.laser_nodes import LaserNodes, laser_nodes
from mapmyworld.registration.scan_matching import scan_set
from mapmyworld.types import ConstraintKind, Judged

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
    count = len(poses)
    variances = np.full((count, 2), [2.0 * METRES**2, RADIANS**2])
    nodes = laser_nodes(np.arange(count, dtype=np.int64), scan_set([]), poses, variances)
    return replace(nodes, stated=tuple(motion(poses, k, k + 1) for k in range(count - 1)))


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
    closed = replace(ring, stated=(*ring.stated, motion(ring.poses, 39, 0)))
    one, both = (drift_priors(nodes, [(0, 20)])[0].covariance for nodes in (ring, closed))
    least = np.diag([SLACK[0], *SLACK]) ** 2 / 9.0
    assert np.linalg.eigvalsh(both - least).max() < 0.6 * np.linalg.eigvalsh(one - least).max()


def test_what_the_graph_does_not_connect_is_as_open_as_the_path_between() -> None:
    poses = np.stack([np.arange(41.0), np.zeros(41), np.zeros(41)], axis=-1)
    nodes = nodes_of(poses)
    parted = replace(nodes, stated=nodes.stated[:20] + nodes.stated[21:])
    known, unknown = drift_priors(parted, [(0, 20), (0, 40)])
    whole, _ = drift_priors(nodes, [(0, 20), (0, 40)])
    np.testing.assert_allclose(known.covariance, whole.covariance)
    metres, radians = nodes.drift.reach(0, 40)
    assert unknown.window(np.inf) == pytest.approx((SLACK[0] + metres, SLACK[1] + radians))
    assert drift_priors(nodes, []) == []
