"""The two chosen numbers of the robust rule, halved and doubled, on graphs that chose neither.

python benchmarks/graph_constants.py [--seeds 2] [--shares 0.3 0.5]
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Callable

import numpy as np
from graph_false import with_false
from graph_worlds import cubicle, grid, sphere, streets, torus, world

from mapmyworld.config import GraphConfig
from mapmyworld.graph import clusters, inlier_recovery
from mapmyworld.graph.optimisation import optimise, optimise_robustly
from mapmyworld.types.pose_graph import PoseGraph

DRAFT = GraphConfig(certify=False)
MADE: dict[str, Callable[[int], PoseGraph]] = {
    "streets": lambda seed: streets(np.random.default_rng(seed), 0.02)[1],
    "manhattan": lambda seed: world("manhattan", 1500, seed),
    "spiral": lambda seed: world("spiral", 1500, seed),
    "grid3D": lambda seed: grid(np.random.default_rng(seed))[1],
    "torus3D": lambda seed: torus(np.random.default_rng(seed))[1],
    "sphere": lambda seed: sphere(np.random.default_rng(seed))[1],
    "cubicle": lambda seed: cubicle(np.random.default_rng(seed))[1],
}
VARIANTS = ((0.2, 2.0), (0.1, 2.0), (0.4, 2.0), (0.2, 1.0), (0.2, 4.0))


def row(kind: str, seed: int, share: float) -> None:
    """False closures kept, true ones lost, and the cost of all true ones, for every variant."""
    graph = MADE[kind](seed)
    clean = optimise(graph, DRAFT).squared_sigmas
    mixed = with_false(graph, share, seed)
    true = np.arange(len(mixed.edges)) < len(graph.edges)
    cells, started = [], time.process_time()
    for expected, heavy in VARIANTS:
        inlier_recovery._FALSE, inlier_recovery.HEAVY, clusters.HEAVY = expected, heavy, heavy
        solved = optimise_robustly(mixed, DRAFT)
        false, lost = int(solved.accepted[~true].sum()), int((~solved.accepted[true]).sum())
        ratio = solved.squared_sigmas[true].sum() / clean.sum()
        cells.append(f"{false:>5}{lost:>5}{ratio:>9.4f}")
    seconds = time.process_time() - started
    counts = f"{int((~graph.edges.odometry).sum()):>6}{int((~true).sum()):>6}"
    print(f"{kind:<10}{seed:>5}{share:>6.0%}{counts}", *cells, f"{seconds:>7.1f}", sep=" |")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else "")
    parser.add_argument("--graphs", nargs="*", default=list(MADE))
    parser.add_argument("--seeds", type=int, default=2)
    parser.add_argument("--shares", type=float, nargs="*", default=[0.3, 0.5])
    chosen = parser.parse_args()
    names = [f"{expected:g}, {heavy:g}: false, lost, cost" for expected, heavy in VARIANTS]
    print("graph, seed, share, true, false", *names, "CPU s", sep=" | ")
    for kind in chosen.graphs:
        for seed in range(21, 21 + chosen.seeds):
            for share in chosen.shares:
                row(kind, seed, share)


if __name__ == "__main__":
    main()
