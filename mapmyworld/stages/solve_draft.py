"""The graph of a map so far, solved roughly."""

from __future__ import annotations

from collections.abc import Sequence

from mapmyworld.config import Config
from mapmyworld.graph.draft_graph import Draft, landmark_guesses, solve_draft
from mapmyworld.sensing.plan import moves_in_plane
from mapmyworld.types import Judged, MapStore


def solve_draft_of(
    store: MapStore, config: Config, constraints: Sequence[Judged], until: int | None = None
) -> Draft:
    """The graph of a store's nodes with these constraints, up to the node with the id `until`."""
    nodes = [node for node in store.nodes() if until is None or node.id <= until]
    if until is not None:
        constraints = [c for c in constraints if max(c.from_id, c.to_id) <= until]
    starts = {node.id: node.tracked_from_base for node in nodes}
    planar = moves_in_plane(store)
    landmarks = landmark_guesses(starts, constraints)
    return solve_draft(nodes, landmarks, constraints, planar, config.graph)
