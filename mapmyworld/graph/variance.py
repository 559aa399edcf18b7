"""How honest stated covariances are: variance components, estimated on the graph itself.

A solution absorbs part of every error, and most of that of the constraints which weigh most; what
is left of an edge's squared sigmas is expected to be its redundancy `trace(I - W P)`, with P the
covariance that the solution gives its residual. A kind's variance factor makes the two sums equal
at the solution by the scaled covariances. Forstner, "Ein Verfahren zur Schatzung von Varianz- und
Kovarianzkomponenten" (1979).

That holds at the constraints' own solution only. Poses that all scans were aligned at come from
other measurements, and leave the whole of an error: of motions between few closures, thirty times
their redundancy.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from itertools import count

import numpy as np

from mapmyworld.backend.descent import optimised_roughly
from mapmyworld.backend.information import NotPositiveDefiniteError, information_of
from mapmyworld.backend.predictions import predictions
from mapmyworld.backend.system import System, edge_chi2
from mapmyworld.geometry import Array
from mapmyworld.graph.constraint_system import StatedSystem, stated_system
from mapmyworld.graph.motion_chains import are_motions, composed_motions, kept_nodes
from mapmyworld.types import CLOSURES, ConstraintKind, Judged, Node, Poses

_SCALED = frozenset({ConstraintKind.NEIGHBOUR}) | CLOSURES  # what a person stated holds as stated
_LEAST = 3.0  # redundancy of a component, below which its residuals indicate nothing
_SETTLED = 0.1  # relative change of factors from which another estimate is not worth its time
_ROUNDS = 10  # of estimates, each at the solution by the one before; of real logs two to eight
_ROUNDING = 1e-4  # smallest factor: errors of a hundredth of what is stated


def variance_factors(
    nodes: Sequence[Node], constraints: Sequence[Judged], poses: Poses, planar: bool
) -> dict[str, float]:
    """Variance factors of neighbours and of measured closures, by what contradicts them.

    What is stated counts as one observation (a unit-information prior: Kass and Wasserman, 1995),
    so that what nothing checks keeps its covariances. The accepted constraints are compared at
    their own solution, which lies near the `poses`.
    """
    components, stated = _between_ends(nodes, constraints, poses, planar)
    factors = {_component_of(kind): 1.0 for kind in _SCALED if _component_of(kind) in components}
    solution = stated.start
    for _ in range(_ROUNDS if factors else 0):
        scale = np.array([factors.get(name, 1.0) for name in components])
        information = stated.system.information / scale[:, None, None]
        system = replace(stated.system, information=information)
        solution = optimised_roughly(system, solution)
        sums = _sums(system, components, solution)
        before = factors
        factors = {k: _next(f, *sums.get(k, (0.0, 0.0))) for k, f in before.items()}
        if all(abs(f - before[k]) <= _SETTLED * before[k] for k, f in factors.items()):
            break
    return {
        str(kind): factors[_component_of(kind)]
        for kind in sorted(_SCALED)
        if _component_of(kind) in factors
    }


def _component_of(kind: ConstraintKind) -> str:
    """The kinds that err alike: all closures are matched in the same way, whenever looked for."""
    return "closure" if kind in CLOSURES else str(kind)


def _next(factor: float, chi2: float, redundancy: float) -> float:
    """A factor by squared sigmas and redundancy at the last one, and by what was stated.

    The logarithm of a variance errs alike whatever it is: its mean with one observation of none.
    """
    found = factor * chi2 / redundancy if redundancy > 0.0 else 1.0
    return float(max(found, _ROUNDING) ** (redundancy / (redundancy + 1.0)))


def _between_ends(
    nodes: Sequence[Node], constraints: Sequence[Judged], poses: Poses, planar: bool
) -> tuple[list[str], StatedSystem]:
    """The system of nodes that more than motion ties, and the component of each of its edges.

    Motions along a chain err together as the one that they compose to: nothing else checks them.
    """
    ids, row = np.array([n.id for n in nodes], np.int64), dict(zip(poses.ids.tolist(), count()))
    used = [c for c in constraints if c.accepted and c.from_id in row and c.to_id in row]
    usable = are_motions(used, set(ids.tolist()))
    motions = [c for c, own in zip(used, usable, strict=True) if own]
    others = [c for c, own in zip(used, usable, strict=True) if not own]
    kept = kept_nodes(nodes, motions, others)
    held = np.concatenate([ids[kept], poses.ids[poses.ids < 0]])
    edges = [*composed_motions(motions, set(ids[kept].tolist())), *others]
    guess = poses.map_from_node[[row[i] for i in held.tolist()]]
    return [_component_of(c.kind) for c in edges], stated_system(held, guess, edges, planar)


def normalised_residuals(
    constraints: Sequence[Judged], poses: Poses, planar: bool
) -> dict[str, float]:
    """Kind -> how many times larger than stated its errors are (sigmas), by accepted constraints.

    They are judged at their own solution, which lies near the `poses`; all closures together. Kinds
    that nothing else checks are left out.
    """
    known = set(poses.ids.tolist())
    used = [c for c in constraints if c.accepted and {c.from_id, c.to_id} <= known]
    if not used:
        return {}
    stated = stated_system(poses.ids, poses.map_from_node, used, planar)
    solution = optimised_roughly(stated.system, stated.start)
    sums = _sums(stated.system, [_component_of(c.kind) for c in used], solution)
    known_of = {kind: sums.get(_component_of(kind), (0.0, 0.0)) for kind in {c.kind for c in used}}
    return {
        str(kind): float(np.sqrt(chi2 / redundancy))
        for kind, (chi2, redundancy) in sorted(known_of.items())
        if redundancy >= _LEAST
    }


def _sums(
    system: System, components: Sequence[str], solution: Array
) -> dict[str, tuple[float, float]]:
    """Component -> squared sigmas and redundancy of its edges; {} where a node is undetermined."""
    try:
        information = information_of(system, solution)
    except NotPositiveDefiniteError:
        return {}
    alone = list(np.arange(len(components)).reshape(-1, 1))
    predicted = [p.covariance for p in predictions(information, system, solution, alone)]
    left = system.dimension - np.trace(predicted, axis1=1, axis2=2)
    names, chi2 = np.array(components), edge_chi2(system, solution)
    return {
        str(name): (float(chi2[names == name].sum()), float(left[names == name].sum()))
        for name in np.unique(names)
    }
