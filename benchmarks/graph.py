"""Tables about the back end: optima, false closures, size, marginals.

python benchmarks/graph.py graphs     cost and time beside plain gtsam
python benchmarks/graph.py robust     random and consistent false closures
python benchmarks/graph.py scale      cost against size, to 100,000 poses
python benchmarks/graph.py marginals  covariances of all nodes
"""

from __future__ import annotations

import argparse
import os
import resource
import time
from dataclasses import replace
from pathlib import Path

import numpy as np

from formats.pose_graph import read_graph
from mapmyworld.config.graph import GraphConfig
from mapmyworld.geometry import (
    between,
    between_planar,
    compose_planar,
    make_transform,
    quaternion_to_rotation,
)
from mapmyworld.graph.certificate import certify
from mapmyworld.graph.covariance import marginal_covariances
from mapmyworld.graph.optimise import optimise, optimise_robustly
from mapmyworld.graph.problem import problem_of
from mapmyworld.types.pose_graph import Edges, PoseGraph, no_priors, no_sightings

ROOT = Path(__file__).resolve().parent.parent
DATA = Path(os.environ.get("MAPMYWORLD_DATA", ROOT.parent / "shared" / "data")) / "graphs"
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


def graphs(names: list[str]) -> None:
    print(
        f"{'graph':<16}{'listed':>12}{'ours':>12}{'gtsam':>12}{'bound':>12}{'twin':>6}"
        f"{'read':>8}{'ours':>8}{'gtsam':>8}{'ratio':>7}{'proof':>8}"
    )
    optimise(world("manhattan", 50))  # imports are not what is measured
    _plain_gtsam(DATA / "tinyGrid3D.g2o", False)
    for name in names:
        path = DATA / f"{name}.g2o"
        started = time.process_time()
        graph = read_graph(path).graph
        read = time.process_time() - started
        # The stored vertices are thrown away: odometry and closures alone.
        origin = np.zeros(3) if graph.planar else np.eye(4)
        blind = replace(graph, map_from_node=np.tile(origin, (len(graph), *[1] * origin.ndim)))
        started = time.process_time()
        solved = optimise(blind, GraphConfig(certify=False))
        ours = time.process_time() - started
        problem = problem_of(solved.graph)
        started = time.process_time()
        found = certify(problem.system, problem.guess)
        proof = time.process_time() - started
        cost, plain = _plain_gtsam(path, graph.planar)
        print(
            f"{name:<16}{OPTIMA.get(name, np.nan):>12.8g}{solved.cost:>12.8g}{cost:>12.8g}"
            f"{found.lower_bound:>12.8g}{found.twin_is_global!s:>6}"
            f"{read:>8.3f}{read + ours:>8.3f}{plain:>8.3f}{(read + ours) / plain:>7.2f}"
            f"{proof:>8.3f}",
            flush=True,
        )


def _plain_gtsam(path: Path, planar: bool) -> tuple[float, float]:
    """Cost and CPU seconds of gtsam as its examples use it: read, one start, one optimiser."""
    import gtsam

    started = time.process_time()
    factors, _ = gtsam.readG2o(str(path), not planar)
    if planar:
        anchor = gtsam.PriorFactorPose2(0, gtsam.Pose2(), gtsam.noiseModel.Unit.Create(3))
        diagonal = gtsam.NonlinearFactorGraph()
        for k in range(factors.size()):
            factor = factors.at(k)
            spread = factor.noiseModel().covariance()
            noise = gtsam.noiseModel.Diagonal.Variances(np.diag(spread))
            a, b = factor.keys()
            diagonal.add(gtsam.BetweenFactorPose2(a, b, factor.measured(), noise))
        diagonal.add(anchor)
        start = gtsam.lago.initialize(diagonal)
    else:
        anchor = gtsam.PriorFactorPose3(0, gtsam.Pose3(), gtsam.noiseModel.Unit.Create(6))
    factors.add(anchor)
    if not planar:
        start = gtsam.InitializePose3.initialize(factors)
    solved = gtsam.LevenbergMarquardtOptimizer(factors, start).optimize()
    return factors.error(solved), time.process_time() - started


def with_false(graph: PoseGraph, share: float, seed: int, group: int = 1) -> PoseGraph:
    """The graph with so many false closures that they are this share of all closures.

    Measured are random relative poses within a fifth of the world. In groups, neighbouring nodes
    see one wrong place, so that the closures of a group agree with each other and odometry.
    """
    rng = np.random.default_rng(seed)
    edges, count = graph.edges, len(graph)
    closures = np.flatnonzero(~edges.odometry)
    number = round(len(closures) * share / (1.0 - share) / group)
    solved = optimise(graph, GraphConfig(certify=False)).graph.map_from_node
    places = solved[:, :2] if graph.planar else solved[:, :3, 3]
    reach = 0.1 * float(np.ptp(places, axis=0).max())
    tails, heads, motions = [], [], []
    while len(tails) < number * group:
        a, b = rng.integers(0, count - group, 2)
        if abs(a - b) < 20 + group:
            continue
        base = _random_motion(graph.planar, reach, rng)
        if _is_true(graph.planar, solved[a], solved[b], base):
            continue
        for k in range(group):
            motions.append(_joined(graph.planar, solved, int(a), int(b), k, base))
            tails.append(int(a) + k)
            heads.append(int(b) + k)
    information = edges.information[closures[rng.integers(0, len(closures), len(tails))]]
    return replace(
        graph,
        edges=Edges(
            np.concatenate([edges.from_ids, graph.ids[tails]]),
            np.concatenate([edges.to_ids, graph.ids[heads]]),
            np.concatenate([edges.from_from_to, np.array(motions)]),
            np.concatenate([edges.information, information]),
            np.concatenate([edges.odometry, np.zeros(len(tails), np.bool_)]),
        ),
    )


def _random_motion(planar: bool, reach: float, rng: np.random.Generator) -> np.ndarray:
    if planar:
        return np.array([*rng.uniform(-reach, reach, 2), rng.uniform(-np.pi, np.pi)])
    turn = quaternion_to_rotation(rng.normal(size=4))
    return make_transform(turn, rng.uniform(-reach, reach, 3))


def _is_true(planar: bool, a: np.ndarray, b: np.ndarray, drawn: np.ndarray) -> bool:
    """Whether a drawn closure happens to be right: within 0.3 m and 0.1 rad (6 deg)."""
    if planar:
        error = between_planar(drawn, between_planar(a, b))
        return bool(np.hypot(*error[:2]) < 0.3 and abs(error[2]) < 0.1)
    error = between(drawn, between(a, b))
    return bool(
        np.linalg.norm(error[:3, 3]) < 0.3 and np.trace(error[:3, :3]) > 1 + 2 * np.cos(0.1)
    )


def _joined(
    planar: bool, poses: np.ndarray, a: int, b: int, k: int, base: np.ndarray
) -> np.ndarray:
    """What node a + k sees of b + k when a sees b at `base`."""
    if planar:
        back = between_planar(poses[a + k], poses[a])
        return compose_planar(compose_planar(back, base), between_planar(poses[b], poses[b + k]))
    return between(poses[a + k], poses[a]) @ base @ between(poses[b], poses[b + k])


def robust(names: list[str], seeds: int) -> None:
    print(
        f"{'graph':<12}{'false':>7}{'group':>6}{'seed':>5}{'added':>7}{'kept false':>11}"
        f"{'kept true':>10}{'cost, all':>11}{'cost, kept':>11}{'CPU s':>7}"
    )
    for name in names:
        graph = read_graph(DATA / f"{name}.g2o").graph
        clean = optimise(graph, GraphConfig(certify=False))
        for share, group in ((0.1, 1), (0.3, 1), (0.5, 1), (0.1, 5), (0.3, 5), (0.1, 20)):
            for seed in range(seeds if group == 1 else 1):
                _robust_row(name, graph, clean.squared_sigmas, share, group, seed)


def _robust_row(
    name: str, graph: PoseGraph, clean: np.ndarray, share: float, group: int, seed: int
) -> None:
    mixed = with_false(graph, share, seed, group)
    started = time.process_time()
    solved = optimise_robustly(mixed, GraphConfig(certify=False))
    seconds = time.process_time() - started
    true = np.arange(len(mixed.edges)) < len(graph.edges)
    kept_true = float(solved.accepted[true & ~mixed.edges.odometry].mean())
    kept_false = int(solved.accepted[~true].sum())
    # All true edges, also those left out, against the clean optimum's cost; and the kept ones.
    kept = solved.accepted & true
    every = solved.squared_sigmas[true].sum() / clean.sum()
    ratio = solved.squared_sigmas[kept].sum() / clean[kept[: len(graph.edges)]].sum()
    print(
        f"{name:<12}{share:>7.0%}{group:>6}{seed:>5}{(~true).sum():>7}{kept_false:>11}"
        f"{kept_true:>10.1%}{every:>11.4f}{ratio:>11.4f}{seconds:>7.1f}",
        flush=True,
    )


def world(kind: str, count: int, seed: int = 0) -> PoseGraph:
    """A simulated drive, with closures to half as many earlier nodes nearby.

    "manhattan": a walk along the streets of a grid, 1 m a step; "spiral": ever wider rounds, each
    node seeing the round before.
    """
    rng = np.random.default_rng(seed)
    truth = _streets(count, rng) if kind == "manhattan" else _spiral(count)
    from scipy.spatial import cKDTree

    pairs = cKDTree(truth[:, :2]).query_pairs(1.5, output_type="ndarray")
    pairs = np.sort(pairs, axis=1)
    pairs = pairs[pairs[:, 1] - pairs[:, 0] > 10]
    pairs = pairs[rng.permutation(len(pairs))[: count // 2]]
    chain = np.column_stack([np.arange(count - 1), np.arange(1, count)])
    ends = np.concatenate([chain, pairs])
    sigma = np.array([0.05, 0.05, 0.01])
    noise = rng.normal(size=(len(ends), 3)) * sigma
    measured = compose_planar(between_planar(truth[ends[:, 0]], truth[ends[:, 1]]), noise)
    information = np.tile(np.diag(sigma**-2), (len(ends), 1, 1))
    edges = Edges(ends[:, 0], ends[:, 1], measured, information, np.arange(len(ends)) < count - 1)
    return PoseGraph(
        True,
        np.arange(count),
        np.zeros((count, 3)),
        edges,
        landmarks=np.zeros((0, 2)),
        sightings=no_sightings(True),
        priors=no_priors(True),
    )


def _streets(count: int, rng: np.random.Generator) -> np.ndarray:
    side = int(np.sqrt(count) * 0.6)
    turns = rng.choice([-1, 0, 1], count)
    poses, x, y, heading = np.zeros((count, 3)), 0, 0, 0
    steps = ((1, 0), (0, 1), (-1, 0), (0, -1))
    for k in range(count):
        poses[k] = x, y, heading * np.pi / 2
        if k % 4 == 3:
            heading = (heading + int(turns[k])) % 4
        while not (0 <= x + steps[heading][0] <= side and 0 <= y + steps[heading][1] <= side):
            heading = (heading + 1) % 4
        x, y = x + steps[heading][0], y + steps[heading][1]
    return poses


def _spiral(count: int) -> np.ndarray:
    length = np.arange(count, dtype=np.float64)
    angle = np.sqrt(4.0 * np.pi * length) + 1e-9
    radius = angle / (2.0 * np.pi)
    return np.column_stack([radius * np.cos(angle), radius * np.sin(angle), angle + np.pi / 2])


def scale(sizes: list[int]) -> None:
    print(
        f"{'world':<12}{'poses':>8}{'edges':>8}{'CPU s':>8}{'steps':>7}{'chi2/dof':>10}"
        f"{'peak GB':>9}"
    )
    for kind in ("manhattan", "spiral"):
        for count in sizes:
            graph = world(kind, count)
            started = time.process_time()
            solved = optimise(graph)
            seconds = time.process_time() - started
            freedom = 3 * (len(graph.edges) - count + 1)
            peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 2**20
            print(
                f"{kind:<12}{count:>8}{len(graph.edges):>8}{seconds:>8.1f}{solved.iterations:>7}"
                f"{2 * solved.cost / freedom:>10.4f}{peak:>9.2f}",
                flush=True,
            )


def marginals(sizes: list[int]) -> None:
    print(f"{'world':<12}{'poses':>8}{'CPU s':>8}{'largest sigma m':>17}")
    for kind in ("manhattan", "spiral"):
        for count in sizes:
            graph = optimise(world(kind, count)).graph
            problem = problem_of(graph)
            started = time.process_time()
            spread = marginal_covariances(problem.system, problem.guess)
            seconds = time.process_time() - started
            assert spread is not None
            largest = np.sqrt(np.trace(spread[:, :2, :2], axis1=1, axis2=2).max())
            print(f"{kind:<12}{count:>8}{seconds:>8.1f}{largest:>17.3f}", flush=True)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else "")
    parser.add_argument("table", choices=["graphs", "robust", "scale", "marginals"])
    parser.add_argument("--graphs", nargs="*", default=None)
    parser.add_argument("--seeds", type=int, default=3)
    parser.add_argument("--sizes", type=int, nargs="*", default=None)
    chosen = parser.parse_args()
    if chosen.table == "graphs":
        graphs(chosen.graphs or list(OPTIMA))
    elif chosen.table == "robust":
        robust(chosen.graphs or ["manhattan", "intel", "sphere2500"], chosen.seeds)
    elif chosen.table == "scale":
        scale(chosen.sizes or [1000, 10_000, 100_000])
    else:
        marginals(chosen.sizes or [1000, 10_000])


if __name__ == "__main__":
    main()
