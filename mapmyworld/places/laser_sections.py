"""Laser closures of a whole path, section by section."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from itertools import pairwise

import numpy as np

from mapmyworld.config import Config
from mapmyworld.graph.solved_graph import SolvedGraph
from mapmyworld.places.laser_candidates import candidate_pairs
from mapmyworld.places.laser_closures import compare_places
from mapmyworld.places.laser_nodes import NodeScans, metres_driven, nodes_at
from mapmyworld.types import Judged, Poses, Progress

_SECTION = 200.0  # m of path, about, that are searched before what was found is solved

Solve = Callable[[Sequence[Judged], int | None], SolvedGraph]
"""Solves the graph with these constraints, up to the node with an id; None for all of it."""


def closures_by_section(
    loaded: NodeScans, stored: Sequence[Judged], solve: Solve, config: Config, progress: Progress,
    start: Poses | None = None,
) -> list[Judged]:  # fmt: skip
    """Pairs of places compared, each with its verdict; the `stored` constraints are known before.

    The search reaches as far as the drift may have gone, up to 15 m: since the earlier visit, or
    since a closure held the robot. Each section is searched from poses that the closures before it
    hold, so that this is no farther after hours than at first; until there are any, from the
    `start`, or from tracked poses without.
    """
    if len(loaded.nodes) < 2:
        return []
    path = metres_driven(nodes_at(loaded, None).poses)
    count = max(1, round(float(path[-1]) / _SECTION))
    edges = np.searchsorted(path, np.linspace(0.0, path[-1], count + 1)[1:-1])
    found: list[Judged] = []
    for first, end in pairwise([0, *edges.tolist(), len(path)]):
        so_far = [*stored, *found]
        nodes = nodes_at(loaded, start, end, stored)
        if any(c.accepted for c in found) or any(c.is_relocalised for c in so_far):
            draft = solve(so_far, loaded.nodes[end - 1].id)
            nodes = nodes_at(loaded, draft.poses, end, draft.constraints)
        pairs = candidate_pairs(nodes, config, optimised=False, first=first)
        progress.stage("loop closures by laser", len(pairs), "pairs")
        found += compare_places(nodes, pairs, config)
    return found
