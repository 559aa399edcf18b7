"""The graph so far, solved roughly."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

from mapmyworld.config import GraphConfig
from mapmyworld.graph.chains import solve_by_chains
from mapmyworld.graph.solved_graph import SolvedGraph
from mapmyworld.types import Judged, Node


def solve_draft(
    nodes: Sequence[Node], constraints: Sequence[Judged], planar: bool, config: GraphConfig,
    until: int | None = None,
) -> SolvedGraph:  # fmt: skip
    """The graph of nodes with these constraints, up to the node with the id `until`.

    Enough to look again from its poses, at a fraction of the cost.
    """
    if until is not None:
        nodes = [node for node in nodes if node.id <= until]
        constraints = [c for c in constraints if max(c.from_id, c.to_id) <= until]
    quick = replace(config, covariances=False, certify=False, groups=False)
    return solve_by_chains(nodes, constraints, planar, quick, motions_judged=False)
