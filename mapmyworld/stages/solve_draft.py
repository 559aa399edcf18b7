"""The graph of a map so far, solved roughly."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

from mapmyworld.config import Config
from mapmyworld.graph.chains import solve_by_chains
from mapmyworld.graph.solved_graph import SolvedGraph
from mapmyworld.sensing.plan import moves_in_plane
from mapmyworld.types import Judged, MapStore


def solve_draft_of(
    store: MapStore, config: Config, constraints: Sequence[Judged], until: int | None = None
) -> SolvedGraph:
    """The graph of a store's nodes with these constraints, up to the node with the id `until`.

    Enough to look again from its poses, at a fraction of the cost.
    """
    nodes = [node for node in store.nodes() if until is None or node.id <= until]
    if until is not None:
        constraints = [c for c in constraints if max(c.from_id, c.to_id) <= until]
    quick = replace(config.graph, covariances=False, certify=False, groups=False)
    return solve_by_chains(nodes, constraints, moves_in_plane(store), quick, motions_judged=False)
