"""The optimiser: known optima, and results that depend on nothing they should not."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from formats.graph_reading import graph_from_text, read_graph
from mapmyworld.backend.residuals import retract
from mapmyworld.errors import GraphError
from mapmyworld.geometry.planar import between_planar, compose_planar, planar_exp, planar_log
from mapmyworld.geometry.rigid import between, se3_exp
from mapmyworld.graph.optimisation import optimise, optimise_robustly
from mapmyworld.types.pose_graph import Edges, PoseGraph, Sightings, no_priors, no_sightings

OPTIMA = {
    "tinyGrid3D": 9.3139095,
    "smallGrid3D": 517.92533,
    "CSAIL": 20.275442,
    "intel": 22.502117,
    "manhattan": 1774.5205,
    "parking-garage": 0.63419236,
    "sphere2500": 675.70096,
    "torus3D": 12117.637,
}


def ring(planar: bool, count: int = 24, seed: int = 0) -> PoseGraph:
    """A noisy ring with chords, and no useful guess."""
    rng = np.random.default_rng(seed)
    angle = np.linspace(0, 2 * np.pi, count, endpoint=False)
    truth = np.column_stack([10 * np.cos(angle), 10 * np.sin(angle), angle])
    if not planar:
        zero = np.zeros(count)
        truth = se3_exp(np.column_stack([zero, zero, angle, 10 * np.cos(angle), angle, zero]))
    tails = np.concatenate([np.arange(count), np.arange(0, count, 3)])
    heads = np.concatenate([(np.arange(count) + 1), np.arange(0, count, 3) + count // 2]) % count
    size = 3 if planar else 6
    motion = (between_planar if planar else between)(truth[tails], truth[heads])
    measured = retract(planar, motion, 0.02 * rng.normal(size=(len(tails), size)))
    root = rng.normal(size=(len(tails), size, size))
    information = 100 * (root @ np.swapaxes(root, 1, 2) + np.eye(size))
    origin = np.zeros(3) if planar else np.eye(4)
    return PoseGraph(
        planar,
        np.arange(count) * 2 + 5,
        np.tile(origin, (count, *[1] * origin.ndim)),
        Edges(tails * 2 + 5, heads * 2 + 5, measured, information, np.abs(heads - tails) == 1),
        landmarks=np.zeros((0, 2 if planar else 3)),
        sightings=no_sightings(planar),
        priors=no_priors(planar),
    )


@pytest.mark.parametrize("name", ["tinyGrid3D", "smallGrid3D", "CSAIL", "intel"])
def test_small_recorded_graphs_reach_the_optimum_without_their_vertices(data, name):
    check_optimum(data, name)


@pytest.mark.slow
@pytest.mark.parametrize("name", ["manhattan", "parking-garage", "sphere2500", "torus3D"])
def test_large_recorded_graphs_reach_the_optimum_without_their_vertices(data, name):
    check_optimum(data, name)


def check_optimum(data, name):
    graph = read_graph(data / "graphs" / f"{name}.g2o").graph
    origin = np.zeros(3) if graph.planar else np.eye(4)
    blind = replace(graph, map_from_node=np.tile(origin, (len(graph), *[1] * origin.ndim)))
    solved = optimise(blind)
    assert solved.cost == pytest.approx(OPTIMA[name], rel=1e-6)
    assert solved.cost == pytest.approx(0.5 * solved.squared_sigmas.sum())


@pytest.mark.parametrize("planar", [True, False])
def test_the_order_of_edges_changes_nothing(planar):
    graph = ring(planar)
    order = np.random.default_rng(4).permutation(len(graph.edges))
    solved = optimise(graph)
    again = optimise(replace(graph, edges=graph.edges.chosen(order)))
    assert np.array_equal(solved.graph.map_from_node, again.graph.map_from_node)
    assert np.array_equal(solved.squared_sigmas[order], again.squared_sigmas)


def test_a_rigid_motion_of_the_world_moves_the_result_alike():
    graph = ring(True)
    motion = np.array([100.0, -40.0, 2.0])
    moved = replace(graph, map_from_node=compose_planar(motion, graph.map_from_node))
    here, there = optimise(graph), optimise(moved)
    assert there.cost == pytest.approx(here.cost, rel=1e-9)
    expected = compose_planar(motion, here.graph.map_from_node)
    difference = between_planar(expected, there.graph.map_from_node)
    assert np.abs(difference).max() < 1e-6


def test_a_rigid_motion_in_space_moves_the_result_alike():
    graph = ring(False)
    motion = se3_exp(np.array([0.4, -1.1, 2.0, 30.0, -20.0, 5.0]))
    here = optimise(graph)
    there = optimise(replace(graph, map_from_node=motion @ graph.map_from_node))
    assert there.cost == pytest.approx(here.cost, rel=1e-9)
    expected = motion @ here.graph.map_from_node
    assert np.allclose(between(expected, there.graph.map_from_node), np.eye(4), atol=1e-6)


@pytest.mark.parametrize("planar", [True, False])
def test_the_order_of_nodes_changes_nothing(planar):
    """Other names for the same nodes, so that they stand in another order."""
    graph = ring(planar)
    order = np.random.default_rng(5).permutation(np.arange(1, len(graph)))
    order = np.concatenate([[0], order])  # the first node is what holds the world
    renamed = np.empty(len(graph), np.int64)
    renamed[order] = np.arange(len(graph))
    at = [np.searchsorted(graph.ids, k) for k in (graph.edges.from_ids, graph.edges.to_ids)]
    edges = replace(graph.edges, from_ids=renamed[at[0]], to_ids=renamed[at[1]])
    again = optimise(
        replace(
            graph,
            ids=np.arange(len(graph)),
            map_from_node=graph.map_from_node[order],
            edges=edges,
        )
    )
    here = optimise(graph)
    assert again.cost == pytest.approx(here.cost, rel=1e-7)
    found = again.graph.map_from_node[renamed]
    assert np.allclose(found, here.graph.map_from_node, atol=1e-4)


def test_false_closures_are_rejected_in_a_graph_with_landmarks():
    """Six points seen from everywhere leave no doubt about three wrong closures."""
    graph = ring(True, 60)
    rng = np.random.default_rng(8)
    truth = optimise(graph).graph.map_from_node
    points = rng.uniform(-15, 15, (6, 2))
    node, mark = (k.ravel() for k in np.meshgrid(np.arange(60), np.arange(6), indexing="ij"))
    seen = between_planar(truth[node], np.column_stack([points[mark], 0 * mark]))[:, :2]
    weights = np.tile(np.eye(2) * 100, (len(node), 1, 1))
    sightings = Sightings(graph.ids[node], mark + 1000, seen, weights, np.zeros(len(node), bool))
    edges, wrong = graph.edges, rng.uniform(-3, 3, (3, 3))
    mixed = Edges(
        np.concatenate([edges.from_ids, graph.ids[[3, 10, 20]]]),
        np.concatenate([edges.to_ids, graph.ids[[40, 33, 50]]]),
        np.concatenate([edges.i_from_j, wrong]),
        np.concatenate([edges.information, edges.information[:3]]),
        np.concatenate([edges.odometry, np.zeros(3, np.bool_)]),
    )
    marks = {"landmark_ids": np.arange(1000, 1006), "landmarks": np.zeros((6, 2))}
    solved = optimise_robustly(replace(graph, edges=mixed, sightings=sightings, **marks))
    assert not solved.accepted[-3:].any()
    assert solved.accepted[:-3].all()
    assert np.allclose(solved.graph.landmarks, points, atol=0.05)


@pytest.mark.parametrize("planar", [True, False])
def test_our_own_descent_and_gtsam_agree(planar):
    """A fixed first node takes the way without gtsam; it changes nothing but the way."""
    graph = ring(planar)
    own = optimise(replace(graph, fixed_ids=graph.ids[:1]))
    theirs = optimise(graph)
    assert own.cost == pytest.approx(theirs.cost, rel=1e-6)
    assert np.allclose(own.graph.map_from_node, theirs.graph.map_from_node, atol=1e-3)


def test_a_fixed_node_stays_and_a_prior_pulls():
    graph = graph_from_text(
        "VERTEX_SE2 0 5 5 0\nVERTEX_SE2 1 6 5 0\nFIX 0\nEDGE_SE2 0 1 1 0 0 1 0 0 1 0 1\n"
        "EDGE_PRIOR_SE2 1 9 5 0 1 0 0 1 0 1\n"
    ).graph
    solved = optimise(graph).graph.map_from_node
    # One unit of information says x = 6, another x = 9: the mean, and nothing else moves.
    assert np.allclose(solved, [[5, 5, 0], [7.5, 5, 0]], atol=1e-9)


@pytest.mark.parametrize("polar", [True, False])
def test_landmarks_and_path_are_found_without_a_guess(polar):
    rng = np.random.default_rng(8)
    graph = ring(True)
    truth = optimise(graph).graph.map_from_node
    points = rng.uniform(-15, 15, (6, 2))
    node, landmark = np.meshgrid(np.arange(len(truth)), np.arange(6), indexing="ij")
    node, landmark = node.ravel(), landmark.ravel()
    seen = between_planar(truth[node], np.column_stack([points[landmark], 0 * landmark]))[:, :2]
    if polar:
        seen = np.column_stack([np.arctan2(seen[:, 1], seen[:, 0]), np.hypot(*seen.T)])
    sightings = Sightings(
        graph.ids[node],
        landmark + 1000,
        seen,
        np.tile(np.eye(2) * 1e4, (len(node), 1, 1)),
        np.full(len(node), polar),
    )
    solved = optimise(
        replace(
            graph,
            landmark_ids=np.arange(1000, 1006),
            landmarks=np.zeros((6, 2)),
            sightings=sightings,
        )
    )
    assert np.allclose(solved.graph.landmarks, points, atol=0.05)
    assert "growing" in solved.start_costs


@pytest.mark.slow
def test_victoria_park_is_found_from_dead_reckoning(data):
    graph = read_graph(data / "graphs" / "victoria_park.txt").graph
    solved = optimise(graph)
    assert solved.converged
    freedom = 3 * len(graph.edges) + 2 * len(graph.sightings) - 3 * len(graph) + 3 - 2 * 151
    assert 0.2 < 2 * solved.cost / freedom < 2.0
    assert solved.cost == pytest.approx(3092.0611, rel=1e-7)
    assert "certified (gap 1.6 %)" in solved.certainty


def test_parts_are_solved_each_with_an_anchor_of_its_own():
    first, second = ring(True), ring(True, seed=1)
    shift = 1000
    edges = second.edges
    both = replace(
        first,
        ids=np.concatenate([first.ids, second.ids + shift]),
        map_from_node=np.concatenate([first.map_from_node, second.map_from_node]),
        edges=Edges(
            np.concatenate([first.edges.from_ids, edges.from_ids + shift]),
            np.concatenate([first.edges.to_ids, edges.to_ids + shift]),
            np.concatenate([first.edges.i_from_j, edges.i_from_j]),
            np.concatenate([first.edges.information, edges.information]),
            np.concatenate([first.edges.odometry, edges.odometry]),
        ),
    )
    solved = optimise(both)
    assert solved.component.tolist() == [0] * len(first) + [1] * len(second)
    expected = optimise(first).cost + optimise(second).cost
    assert solved.cost == pytest.approx(expected, rel=1e-6)


def test_a_graph_without_nodes_or_with_unknown_ones_is_refused():
    graph = ring(True)
    with pytest.raises(GraphError, match="no nodes"):
        optimise(replace(graph, ids=graph.ids[:0], map_from_node=graph.map_from_node[:0]))
    with pytest.raises(GraphError, match="lacks"):
        optimise(replace(graph, ids=graph.ids + 1))


@pytest.mark.slow
@pytest.mark.parametrize("name", ["intel", "manhattan"])
def test_random_false_closures_are_all_rejected(data, name):
    graph = read_graph(data / "graphs" / f"{name}.g2o").graph
    rng = np.random.default_rng(2)
    closures = np.flatnonzero(~graph.edges.odometry)
    number = round(len(closures) * 0.3 / 0.7)
    ends = rng.integers(0, len(graph), (number, 2))
    ends = ends[np.abs(ends[:, 0] - ends[:, 1]) > 20]
    number, edges = len(ends), graph.edges
    motion = rng.uniform([-3, -3, -np.pi], [3, 3, np.pi], (number, 3))
    information = edges.information[closures[rng.integers(0, len(closures), number)]]
    mixed = Edges(
        np.concatenate([edges.from_ids, graph.ids[ends[:, 0]]]),
        np.concatenate([edges.to_ids, graph.ids[ends[:, 1]]]),
        np.concatenate([edges.i_from_j, motion]),
        np.concatenate([edges.information, information]),
        np.concatenate([edges.odometry, np.zeros(number, np.bool_)]),
    )
    solved = optimise_robustly(replace(graph, edges=mixed))
    assert not solved.accepted[len(edges) :].any()
    assert solved.accepted[closures].mean() > 0.95


def test_the_planar_exponential_and_logarithm_are_inverse():
    tangents = np.random.default_rng(0).uniform(-3, 3, (50, 3))
    assert np.allclose(planar_log(planar_exp(tangents)), tangents)
    assert np.allclose(planar_log(np.array([1.0, 2.0, 1e-9])), [1, 2, 1e-9])
