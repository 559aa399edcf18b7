"""Covariances as a graph's own contradictions show them: variance factors, and scans' own noise."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from formats.database import MemoryMap
from mapmyworld.api import Silent
from mapmyworld.config import Config
from mapmyworld.exporting import graph_of
from mapmyworld.geometry import Array
from mapmyworld.geometry.planar import covariance_from_planar, information_from_planar
from mapmyworld.geometry.rigid import between, se3_exp, se3_log
from mapmyworld.graph.canonical_graph import graph_from_constraints
from mapmyworld.graph.covariance import relative_pose
from mapmyworld.graph.solved_graph import solve
from mapmyworld.graph.variance import normalised_residuals, variance_factors
from mapmyworld.map_figures import (
    calibrated,
    calibrated_constraints,
    scan_noise_of,
    variance_factors_of,
)
from mapmyworld.memory_log import MemoryLog
from mapmyworld.pipeline import build_map
from mapmyworld.simulation import SimulationSettings, simulate
from mapmyworld.types import ConstraintKind, Judged, Node, Poses
from tests.test_graph_solve import noisy_constraints, square_walk

PLANE = [3, 4, 2]  # x, y, yaw in a motion's tangent


def nodes_at(truth: Array) -> list[Node]:
    return [Node(k + 1, 0, k, pose, pose) for k, pose in enumerate(truth)]


def stated(constraints: list[Judged], **times: float) -> list[Judged]:
    """The constraints with the variances of a kind stated so many times larger."""
    return [replace(c, information=c.information / times.get(c.kind, 1.0)) for c in constraints]


@pytest.mark.parametrize(("neighbour", "closure"), [(16.0, 25.0), (0.1, 4.0), (1.0, 1.0)])
def test_factors_undo_what_was_stated_wrongly(neighbour: float, closure: float) -> None:
    truth = square_walk(rounds=6)
    sound = noisy_constraints(truth, np.random.default_rng(3))
    wrong = stated(sound, neighbour=neighbour, loop_closure=closure)
    nodes, poses = nodes_at(truth), Poses(np.arange(1, len(truth) + 1), truth)
    factors = variance_factors(nodes, wrong, poses, planar=True)
    assert factors["neighbour"] == pytest.approx(1.0 / neighbour, rel=0.35)
    assert factors["loop_closure"] == pytest.approx(1.0 / closure, rel=0.35)
    found = normalised_residuals(calibrated(wrong, factors), poses, planar=True)
    assert found == pytest.approx({"neighbour": 1.0, "loop_closure": 1.0}, abs=0.15)


def test_what_nothing_checks_keeps_its_covariance() -> None:
    truth = square_walk()
    sound = noisy_constraints(truth, np.random.default_rng(3))
    motions = [c for c in sound if c.kind is ConstraintKind.NEIGHBOUR]
    poses = Poses(np.arange(1, len(truth) + 1), truth)
    for constraints in ([], motions):
        factors = variance_factors(nodes_at(truth), constraints, poses, planar=True)
        assert list(factors.values()) == pytest.approx([1.0] * len(factors))


def test_what_a_person_stated_holds_as_stated() -> None:
    truth = square_walk()
    (measured,) = noisy_constraints(truth, np.random.default_rng(3))[:1]
    by_hand = replace(measured, kind=ConstraintKind.USER)
    scaled = calibrated([measured, by_hand], {"neighbour": 0.25})
    assert np.allclose(scaled[0].information, 4.0 * measured.information)
    assert scaled[1] is by_hand


def errors_in_sigmas(pairs: Array, found: list[Array], spread: list[Array], truth: Array) -> float:
    """NEES per unknown of relative poses (4, 4) with covariances (6, 6), between pairs of rows."""
    errors = [
        se3_log(between(between(truth[a], truth[b]), one))[PLANE]
        for (a, b), one in zip(pairs, found, strict=True)
    ]
    known = [covariance[np.ix_(PLANE, PLANE)] for covariance in spread]
    return float(
        np.mean([e @ np.linalg.solve(s, e) / 3 for e, s in zip(errors, known, strict=True)])
    )


@pytest.mark.parametrize("span", [1, 10, 60])
def test_each_scans_own_noise_counts_once(span: int) -> None:
    """Shapes err by themselves, so that what is between them does not add up along the path.

    Stated is what one motion errs by. Added up, that is far too much; scaled by what contradicts
    it, far too little; with each end's own noise it is right over any span.
    """
    rng, truth = np.random.default_rng(5), square_walk(rounds=5)
    own, rest = np.array([0.02, 0.02, 0.01]), np.array([0.002, 0.002, 0.001])
    shapes = truth @ se3_exp(noise_of(rng, own, len(truth)))
    information = information_from_planar(np.diag(1.0 / (2.0 * own**2)))
    made: list[Judged] = []
    for c in noisy_constraints(truth, rng):
        apart = between(shapes[c.from_id - 1], shapes[c.to_id - 1])
        measured = apart @ se3_exp(noise_of(rng, rest, 1))[0]
        made.append(replace(c, i_from_j=measured, information=information))
    ids = np.arange(1, len(truth) + 1)
    poses = solve(ids, shapes, made, planar=True).poses
    factors = variance_factors(nodes_at(truth), made, poses, planar=True)
    assert factors["neighbour"] == pytest.approx(np.mean(rest**2) / np.mean(2 * own**2), rel=0.5)
    pairs = np.array([(a, a + span) for a in range(0, len(truth) - span, 3)])
    noise = covariance_from_planar(np.diag(own**2))

    def consistency(constraints: tuple[Judged, ...], noise: Array | None) -> float:
        graph = graph_from_constraints(ids, poses.map_from_node, constraints, planar=True)
        found = [relative_pose(graph, a + 1, b + 1, noise) for a, b in pairs.tolist()]
        return errors_in_sigmas(pairs, [f[0] for f in found], [f[1] for f in found], truth)

    assert 0.7 < consistency(calibrated(made, factors), noise) < 1.4
    assert consistency(calibrated(made, factors), None) > 5.0
    if span > 1:
        assert consistency(tuple(made), None) < 0.6


def noise_of(rng: np.random.Generator, sigmas: Array, count: int) -> Array:
    """(count, 6) tangents of motions in the plane."""
    tangents = np.zeros((count, 6))
    tangents[:, PLANE] = rng.normal(size=(count, 3)) * sigmas
    return tangents


@pytest.fixture(scope="module")
def hall() -> tuple[MemoryMap, Array]:
    """A hall driven twice with a laser, and the true poses of its nodes."""
    default = SimulationSettings()
    settings = replace(
        default,
        camera=replace(default.camera, enabled=False),
        imu=replace(default.imu, enabled=False),
    )
    recording, store = simulate("hall", seed=41, laps=2, settings=settings), MemoryMap()
    build_map(MemoryLog(list(recording.messages())), store, Config(), Silent())
    truth = recording.truth.trajectory
    rows = np.searchsorted(truth.stamps_ns, [node.stamp_ns for node in store.nodes()])
    return store, truth.poses[rows]


def test_a_built_map_is_consistent_with_itself(hall: tuple[MemoryMap, Array]) -> None:
    """Normalised residuals were 0.02 to 0.06: centimetres were stated for millimetres."""
    store, _ = hall
    poses = store.poses()
    assert poses is not None
    found = normalised_residuals(calibrated_constraints(store), poses, planar=True)
    assert all(0.6 < residual < 1.5 for residual in found.values()), found
    assert len(found) == 3
    factors, edges = variance_factors_of(store), graph_of(store).edges
    plain = graph_from_constraints(poses.ids, poses.map_from_node, store.constraints(), planar=True)
    motion = np.flatnonzero(edges.odometry)[0]
    assert np.allclose(
        edges.information[motion] * factors["neighbour"], plain.edges.information[motion]
    )


@pytest.mark.parametrize("span", [1, 20, 200])
def test_relative_poses_of_a_built_map_err_as_stated(
    hall: tuple[MemoryMap, Array], span: int
) -> None:
    store, truth = hall
    graph, noise = graph_of(store), scan_noise_of(store)
    ids = [node.id for node in store.nodes()]
    pairs = np.array([(a, a + span) for a in range(20, len(ids) - span, 10)])
    found = [relative_pose(graph, ids[a], ids[b], noise) for a, b in pairs.tolist()]
    consistent = errors_in_sigmas(pairs, [f[0] for f in found], [f[1] for f in found], truth)
    assert 0.5 < consistent < 2.0
