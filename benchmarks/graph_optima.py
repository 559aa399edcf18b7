"""Tables about the back end: optima, false closures, size, marginals.

python benchmarks/graph_optima.py graphs     cost and time beside plain gtsam
python benchmarks/graph_optima.py robust  random and consistent false closures
python benchmarks/graph_optima.py made    simulated graphs of eleven kinds, beside gtsam and truth
python benchmarks/graph_optima.py hard    graphs with many minima, and the best of many restarts
python benchmarks/graph_optima.py large   the same of graphs of 2,400 to 10,000 poses
python benchmarks/graph_optima.py scale      cost against size, to 100,000 poses
python benchmarks/graph_optima.py marginals  covariances of all nodes
"""

from __future__ import annotations

import argparse
import resource
import time
from collections.abc import Iterator
from dataclasses import dataclass, replace
from itertools import product
from pathlib import Path

import numpy as np
from common import DATA
from graph_false import with_false
from graph_gtsam import examples_cost, plain_gtsam
from graph_large import LARGE
from graph_worlds import HARD, KINDS, Maker, world

from formats.graph_reading import read_graph
from mapmyworld.backend import block_matrix
from mapmyworld.backend.descent import descend
from mapmyworld.backend.starts import along_tree, spanning_tree
from mapmyworld.backend.system import System, fit_of
from mapmyworld.config import GraphConfig
from mapmyworld.graph.covariance import marginal_covariances
from mapmyworld.graph.optimisation import OptimisedGraph, optimise, optimise_robustly
from mapmyworld.graph.problem import Problem, problem_of
from mapmyworld.types.pose_graph import PoseGraph

TABLES = ["graphs", "robust", "made", "hard", "large", "scale", "marginals"]
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


def graphs(names: list[str], runs: int) -> None:
    """Medians of at least so many runs in one process, ours and gtsam's by turns.

    Both read the file.
    """
    print(
        f"{'graph':<16}{'listed':>12}{'ours':>12}{'gtsam':>12}{'bound':>12}{'relaxed':>8}"
        f"{'read':>8}{'ours':>8}{'no proof':>10}{'gtsam':>8}{'ratio':>7}{'no proof':>10}"
    )
    optimise(world("manhattan", 4000))  # imports are not what is measured
    for name in names:
        path = DATA / "graphs" / f"{name}.g2o"
        seconds = [sum(_timed_run(path)[2]) for _ in range(2)][1]  # kernels are loaded before it
        timed = [_timed_run(path) for _ in range(max(runs, min(50, int(0.5 / seconds))))]
        read, proven, unproven, plain = np.median([seconds for _, _, seconds in timed], axis=0)
        solved, cost, _ = timed[-1]
        found = solved.certificate
        assert found is not None
        print(
            f"{name:<16}{OPTIMA.get(name, np.nan):>12.8g}{solved.cost:>12.8g}{cost:>12.8g}"
            f"{found.lower_bound:>12.8g}{found.relaxation_is_global!s:>8}"
            f"{read:>8.4f}{read + proven:>8.4f}{read + unproven:>10.4f}{plain:>8.4f}"
            f"{(read + proven) / plain:>7.2f}{(read + unproven) / plain:>10.2f}",
            flush=True,
        )


def _timed_run(path: Path) -> tuple[OptimisedGraph, float, tuple[float, float, float, float]]:
    """Our solution, gtsam's cost, and CPU seconds: reading, ours with and without proof, gtsam."""
    started = time.process_time()
    graph = read_graph(path).graph
    read = time.process_time() - started
    # The stored vertices are thrown away: odometry and closures alone.
    origin = np.zeros(3) if graph.planar else np.eye(4)
    blind = replace(graph, map_from_node=np.tile(origin, (len(graph), *[1] * origin.ndim)))
    solved, proven = _timed(blind, GraphConfig())
    _, unproven = _timed(blind, GraphConfig(certify=False))
    cost, plain = plain_gtsam(path, graph.planar)
    return solved, cost, (read, proven, unproven, plain)


def _timed(graph: PoseGraph, config: GraphConfig) -> tuple[OptimisedGraph, float]:
    """CPU seconds, the order of elimination found anew."""
    block_matrix._ordered.cache_clear()
    started = time.process_time()
    solved = optimise(graph, config)
    return solved, time.process_time() - started


@dataclass(frozen=True, slots=True, eq=False)
class _Tried:
    """A made graph as we solve it, and what it costs elsewhere."""

    problem: Problem
    solved: OptimisedGraph
    seconds: float
    by_gtsam: float
    from_truth: float

    def reported(self, best: float) -> str:
        """How it ends a row of a table: worse than the best of the others?"""
        return f"{self.seconds:>7.1f}{'  worse' if self.solved.cost > 1.0001 * best else ''}"


def _tried(maker: Maker, seed: int) -> _Tried:
    truth, graph = maker(np.random.default_rng(seed))
    started = time.process_time()
    solved = optimise(graph)
    seconds = time.process_time() - started
    problem = problem_of(graph)
    world = np.zeros((1, 3)) if graph.planar else np.eye(4)[None]
    plain = examples_cost(graph)
    true = _optimum(problem.system, np.concatenate([truth, world]))
    return _Tried(problem, solved, seconds, plain, true)


def _optimum(system: System, start: np.ndarray) -> float:
    return descend(system, fit_of(system, start), 1e-7, 300).fit.cost


def made(kinds: list[str], seeds: list[int]) -> None:
    print(
        f"{'graph':<18}{'seed':>5}{'ours':>11}{'gtsam':>11}{'from truth':>11}{'start':>10}"
        f"{'proven':>8}{'CPU s':>7}"
    )
    for kind, seed in product(kinds, seeds):
        tried = _tried(KINDS[kind], seed)
        solved, plain, true = tried.solved, tried.by_gtsam, tried.from_truth
        proven = solved.certificate is not None and solved.certificate.trusted
        print(
            f"{kind:<18}{seed:>5}{solved.cost:>11.6g}{plain:>11.6g}{true:>11.6g}"
            f"{solved.start:>10}{proven!s:>8}{tried.reported(min(true, plain))}",
            flush=True,
        )


def hard(makers: dict[str, Maker], kinds: list[str], seeds: list[int], restarts: int) -> None:
    """Graphs with many minima: ours beside gtsam's, the truth's, and the best of many restarts."""
    print(
        f"{'graph':<18}{'seed':>5}{'ours':>11}{'gtsam':>11}{'from truth':>11}{'restarts':>11}"
        f"{'start':>10}{'gap':>8}{'relaxed':>8}{'CPU s':>7}"
    )
    for kind, seed in product(kinds, seeds):
        tried = _tried(makers[kind], seed)
        solved, plain, true = tried.solved, tried.by_gtsam, tried.from_truth
        starts = random_starts(tried.problem, restarts)
        best = min(_optimum(tried.problem.system, start) for start in starts)
        found = solved.certificate
        assert found is not None
        print(
            f"{kind:<18}{seed:>5}{solved.cost:>11.6g}{plain:>11.6g}{true:>11.6g}{best:>11.6g}"
            f"{solved.start:>10}{found.gap:>8.1%}{found.relaxation_is_global!s:>8}"
            f"{tried.reported(min(true, best, plain))}",
            flush=True,
        )


def random_starts(problem: Problem, count: int) -> Iterator[np.ndarray]:
    """Poses of all nodes along trees whose edges are drawn, as different as the graph allows."""
    rng, system = np.random.default_rng(0), problem.system
    for _ in range(count):
        lot = rng.permutation(len(system.tails)) * len(problem.guess)
        tree = spanning_tree(system, len(problem.guess), lot)
        yield along_tree(system.planar, problem.guess, tree.parents, tree.motions)


def robust(names: list[str], seeds: int, shares: list[float], groups: list[int]) -> None:
    print(
        f"{'graph':<12}{'false':>7}{'group':>6}{'seed':>5}{'added':>7}{'kept false':>11}"
        f"{'kept true':>10}{'cost, all':>11}{'cost, kept':>11}{'CPU s':>7}"
    )
    for name in names:
        graph = read_graph(DATA / "graphs" / f"{name}.g2o").graph
        clean = optimise(graph, GraphConfig(certify=False))
        for share, group in (*((share, 1) for share in shares), *((0.1, size) for size in groups)):
            for seed in range(seeds):
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
    parser.add_argument("table", choices=TABLES)
    parser.add_argument("--graphs", nargs="*", default=None)
    parser.add_argument("--runs", type=int, default=5, help="of `graphs`, at least")
    parser.add_argument("--seeds", type=int, default=3)
    parser.add_argument("--restarts", type=int, default=20, help="of `hard`")
    parser.add_argument("--shares", type=float, nargs="*", default=[0.1, 0.3, 0.5])
    parser.add_argument("--groups", type=int, nargs="*", default=[2, 3, 5, 10])
    parser.add_argument("--sizes", type=int, nargs="*", default=None)
    chosen = parser.parse_args()
    if chosen.table == "graphs":
        graphs(chosen.graphs or list(OPTIMA), chosen.runs)
    elif chosen.table == "robust":
        names = chosen.graphs or ["manhattan", "intel", "sphere2500"]
        robust(names, chosen.seeds, chosen.shares, chosen.groups)
    elif chosen.table == "made":
        made(chosen.graphs or list(KINDS), list(range(11, 11 + chosen.seeds)))
    elif chosen.table == "hard":
        seeds = list(range(21, 21 + chosen.seeds))
        hard(HARD, chosen.graphs or list(HARD), seeds, chosen.restarts)
    elif chosen.table == "large":
        seeds = list(range(71, 71 + chosen.seeds))
        hard(LARGE, chosen.graphs or list(LARGE), seeds, chosen.restarts)
    elif chosen.table == "scale":
        scale(chosen.sizes or [1000, 10_000, 100_000])
    else:
        marginals(chosen.sizes or [1000, 10_000])


if __name__ == "__main__":
    main()
