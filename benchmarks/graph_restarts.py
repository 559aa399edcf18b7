"""Random starts of a pose graph: along random spanning trees, as different as the graph allows."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from mapmyworld.backend.starts import along_tree, spanning_tree
from mapmyworld.graph.problem import Problem


def random_starts(problem: Problem, count: int, seed: int = 0) -> Iterator[np.ndarray]:
    """Poses of all nodes along trees whose edges are drawn; a pose-only graph is assumed."""
    rng, system = np.random.default_rng(seed), problem.system
    for _ in range(count):
        lot = rng.permutation(len(system.tails)) * len(problem.guess)
        tree = spanning_tree(system, len(problem.guess), lot)
        yield along_tree(system.planar, problem.guess, tree.parents, tree.motions)
