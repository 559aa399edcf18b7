"""The graph solved over the nodes that more than motion ties, and all others along the chains.

A drive of hours has most of its nodes in chains: they cost memory and time, and hold nothing that
the composed motion does not (see `motion_chains`). What solving moved is shared out along a chain,
and the uncertainty of a node in it is that of a Brownian bridge between the chain's two ends.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import replace

import numpy as np

from mapmyworld.backend.residuals import chi_squared_quantile
from mapmyworld.config import GraphConfig
from mapmyworld.geometry import Array, Index
from mapmyworld.graph.constraint_system import stated_system
from mapmyworld.graph.graph_verdicts import judged
from mapmyworld.graph.motion_chains import are_motions, composed_motions, kept_nodes, shared_out
from mapmyworld.graph.robust import RobustSolution
from mapmyworld.graph.solved_graph import SolvedGraph, solve
from mapmyworld.parallel import batches
from mapmyworld.types import Constraint, Judge, Judged, Node, Poses

_BLOCK = 4096  # motions that are worked on together, however long the log is
_LONGEST = 16  # nodes of a chain, so that its linearisation errs little


def solve_by_chains(
    nodes: Sequence[Node], constraints: Sequence[Judged], planar: bool, config: GraphConfig,
    *, motions_judged: bool = True,
) -> SolvedGraph:  # fmt: skip
    """As `solve`, all nodes and constraints, from the nodes that closures tie.

    Nodes begin where they were tracked, landmarks where they are seen first. Motions, which nobody
    questions, may be left unjudged.
    """
    fresh = [c.before(Judge.GRAPH) for c in constraints]
    ids = np.array([node.id for node in nodes], np.int64)
    is_motion = are_motions(fresh, set(ids.tolist()))
    motions = [c for c, own in zip(fresh, is_motion, strict=True) if own]
    others = [c for c, own in zip(fresh, is_motion, strict=True) if not own]
    asked = [c for c in others if c.accepted]
    kept = kept_nodes(nodes, motions, asked)
    kept[::_LONGEST] = True
    tracked = {node.id: node.tracked_from_base for node in nodes}
    starts = {i: tracked[i] for i in ids[kept].tolist()} | landmark_guesses(tracked, constraints)
    composed = composed_motions(motions, set(ids[kept].tolist()))
    guess = np.stack(list(starts.values()))
    solved = solve(list(starts), guess, [*composed, *asked], planar, config)
    poses = shared_out(motions, kept, ids, solved.poses)
    own = _judged_motions(motions, ids, poses, planar, config) if motions_judged else iter(motions)
    rest = iter(solved.constraints[len(composed) :])
    verdicts = tuple(
        next(own) if motion else next(rest) if c.accepted else c
        for c, motion in zip(fresh, is_motion, strict=True)
    )
    before, size = np.cumsum(kept) - 1, int(kept.sum())
    component = np.concatenate([solved.component[:size][before], solved.component[size:]])
    return SolvedGraph(poses, verdicts, component, solved.cost, solved.certainty)


def landmark_guesses(
    starts: Mapping[int, Array], constraints: Iterable[Constraint]
) -> dict[int, Array]:
    """Where landmarks are seen first by nodes at such `starts`; id -> map_from_node (4, 4) both."""
    guesses: dict[int, Array] = {}
    for c in constraints:
        if c.to_id < 0 and c.to_id not in guesses:
            guesses[c.to_id] = starts[c.from_id] @ c.i_from_j
    return guesses


def _judged_motions(
    motions: Sequence[Judged], ids: Index, poses: Poses, planar: bool, config: GraphConfig
) -> Iterator[Judged]:
    """The motions, which nobody questions, with what they miss the poses by."""
    for some in batches(motions, _BLOCK):
        stated = stated_system(ids, poses.map_from_node[: len(ids)], some, planar)
        limit = float(chi_squared_quantile(config.inlier_probability, stated.system.dimension))
        found = replace(RobustSolution.untouched(stated.system, stated.start), limit=limit)
        yield from judged(some, [""] * len(some), np.arange(len(some)), found, stated.system)


def solve_draft(
    nodes: Sequence[Node], constraints: Sequence[Judged], planar: bool, config: GraphConfig,
    until: int | None = None,
) -> SolvedGraph:  # fmt: skip
    """The graph solved roughly, up to the node with the id `until`.

    Enough to look again from its poses, at a fraction of the cost.
    """
    if until is not None:
        nodes = [node for node in nodes if node.id <= until]
        constraints = [c for c in constraints if max(c.from_id, c.to_id) <= until]
    quick = replace(config, covariances=False, certify=False, groups=False)
    return solve_by_chains(nodes, constraints, planar, quick, motions_judged=False)
