"""The graph of a map so far, solved roughly."""

from __future__ import annotations

from collections.abc import Sequence

from mapmyworld.config import Config
from mapmyworld.graph.draft import solve_draft
from mapmyworld.graph.solved_graph import SolvedGraph
from mapmyworld.sensing.plan import moves_in_plane
from mapmyworld.types import Judged, MapStore


def solve_draft_of(
    store: MapStore, config: Config, constraints: Sequence[Judged], until: int | None = None
) -> SolvedGraph:
    """The graph of a store's nodes with these constraints, up to the node with the id `until`."""
    return solve_draft(store.nodes(), constraints, moves_in_plane(store), config.graph, until)
