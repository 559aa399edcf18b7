"""Odometry in doubt, once closures are found: drift explains what a loop is off by, or a fault."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np

from mapmyworld.backend.connected_components import components
from mapmyworld.graph.solved_graph import SolvedGraph
from mapmyworld.places.doubted_odometry import in_doubt
from mapmyworld.places.refuted_odometry import FAULT_ODDS
from mapmyworld.types import CLOSURES, Judge, Judged, Verdict, Why


def confirmed_odometry(
    constraints: Sequence[Judged], solve: Callable[[Sequence[Judged]], SolvedGraph]
) -> list[Judged]:
    """The constraints; motions in doubt are as certain as measured again where closures allow it.

    A fault explains whatever a loop is off by, and so does drift. A mixture of both, as in Olson
    and Agarwal, "Inference on networks of mixtures" (2013), of which the likelier one is taken: the
    fault, where it lets a closure in, or lowers what `solve` leaves by more than it is improbable.
    Where no loop checks a motion, it stays in doubt.
    """
    doubted = [row for row, c in enumerate(constraints) if c.accepted and c.is_doubted]
    if not doubted:
        return list(constraints)
    confirmed, anew = set[int](), list[Judged]()
    best = solve(constraints)
    for row in doubted:
        if not _is_in_a_loop(constraints[row], best):
            continue
        rows, motions = confirmed | {row}, [*anew, in_doubt(constraints[row], False)]
        found = solve([*(c for k, c in enumerate(constraints) if k not in rows), *motions])
        if found.cost - best.cost < FAULT_ODDS and _closures_in(found) >= _closures_in(best):
            confirmed, anew, best = rows, motions, found
    verdict = Verdict(Judge.GRAPH, False, Why.CONFIRMED)
    judged = (c.judged(verdict) if k in confirmed else c for k, c in enumerate(constraints))
    return [*judged, *anew]


def _is_in_a_loop(motion: Judged, solved: SolvedGraph) -> bool:
    """Whether other constraints that were believed join its two nodes as well."""
    ends = motion.from_id, motion.to_id
    believed = [(c.from_id, c.to_id) for c in solved.constraints if c.accepted]
    ids, rows = np.unique([*(pair for pair in believed if pair != ends), ends], return_inverse=True)
    *others, mine = rows.reshape(-1, 2)
    part = components(len(ids), *np.reshape(others, (-1, 2)).astype(np.int64).T)
    return bool(part[mine[0]] == part[mine[1]])


def _closures_in(solved: SolvedGraph) -> int:
    return sum(c.accepted for c in solved.constraints if c.kind in CLOSURES)
