"""Laser closures looked at once more, from the final poses.

What one pair of places leaves ambiguous, or open along a corridor, the whole graph decides. And a
closure is measured while the poses around its two nodes are still tracked ones. Where a turn
began between two odometry samples, a node's sweep, and so the closure, may be turned by a degree.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from mapmyworld.alignment.joint_system import is_by_laser
from mapmyworld.config import Config
from mapmyworld.geometry import Array, Index
from mapmyworld.geometry.planar import (
    between_planar,
    information_from_planar,
    invert_planar,
    matrix_to_planar,
    planar_to_matrix,
)
from mapmyworld.places.laser_closures import OPEN, closure_information
from mapmyworld.places.laser_nodes import LaserNodes, NodeScans, joined_sessions, nodes_at
from mapmyworld.places.laser_submaps import match_submaps, place_around
from mapmyworld.places.node_drift import SIGMAS
from mapmyworld.registration.place_evidence import needed_evidence
from mapmyworld.registration.scan_search import APART
from mapmyworld.registration.submaps import MARGIN
from mapmyworld.types import (
    Constraint,
    Judge,
    Judged,
    Poses,
    ScanMatch,
    Verdict,
    Why,
)

Known = Callable[[Index], Array]
"""The standard deviation (P,), m, of how pairs (P, 2) of nodes lie beside each other."""
_METRES, _RADIANS = 0.1, np.radians(0.75)  # by which no true closure misses the final poses
_PRIOR = np.diag(1.0 / np.square([_METRES, _METRES, _RADIANS]))


def refine_closures(
    constraints: Sequence[Judged], poses: Poses, known: Known, config: Config, loaded: NodeScans
) -> tuple[Judged, ...]:
    """The constraints; accepted laser closures that miss the refined poses are measured anew.

    So is what scans did not decide, where it is `known` how two nodes lie beside each other, pairs
    (P, 2) of them to (P,) m, better than two poses that are compared lie apart: the graph decides
    it. The new measurements stand behind all others; they leave open what the scans leave open.
    What was accepted and misses the poses still is rejected.
    """
    nodes = nodes_at(loaded, poses)
    row = {int(i): k for k, i in enumerate(nodes.ids)}
    decided = _decided(constraints, row, joined_sessions(loaded, constraints), known)
    result, anew = list(constraints), list[Judged]()
    for k, c in enumerate(constraints):
        misses = is_by_laser(c) and not _fits(c, nodes, row)
        if misses or k in decided:
            verdict, measured = _reviewed(c, nodes, row, config)
            if misses or measured:
                result[k] = c.judged(verdict)
            anew += measured
    return (*result, *anew)


def _decided(
    constraints: Sequence[Judged], row: dict[int, int], session: Index, known: Known
) -> set[int]:
    """Which of the constraints scans left open, and the poses decide."""
    left = [k for k, c in enumerate(constraints) if c.verdicts and c.verdicts[-1].why in OPEN]
    if not left:
        return set()
    pairs = np.array([(row[constraints[k].from_id], row[constraints[k].to_id]) for k in left])
    together = np.diff(session[pairs], axis=1)[:, 0] == 0
    decided = together & (SIGMAS * known(pairs) < APART[0])
    return set(np.array(left)[decided].tolist())


def _fits(c: Constraint, nodes: LaserNodes, row: dict[int, int]) -> bool:
    """Seen from either end, which differ by the heading's miss over the way between them."""
    a, b, measured = row[c.from_id], row[c.to_id], matrix_to_planar(c.i_from_j)
    misses = _miss(measured, nodes, a, b), _miss(invert_planar(measured), nodes, b, a)
    return all(np.hypot(*m[:2]) <= _METRES and abs(m[2]) <= _RADIANS for m in misses)


def _miss(measured: NDArray[np.float64], nodes: LaserNodes, a: int, b: int) -> NDArray[np.float64]:
    return between_planar(between_planar(nodes.poses[a], nodes.poses[b]), measured)


def _reviewed(
    c: Judged, nodes: LaserNodes, row: dict[int, int], config: Config
) -> tuple[Verdict, list[Judged]]:
    """The verdict on a closure, and what was measured in its place, if that fits."""
    assert isinstance(c.source, ScanMatch)
    a, b = row[c.from_id], row[c.to_id]
    guess = between_planar(nodes.poses[a], nodes.poses[b])
    match = match_submaps(nodes, a, b, guess, config, prior=_PRIOR)
    one, other = place_around(nodes, a, config), place_around(nodes, b, config)
    agreement = one.agreement_with(other, match.pose).evidence
    before = one.agreement_with(other, matrix_to_planar(c.i_from_j)).evidence
    if agreement < max(needed_evidence(_METRES, _RADIANS), before - MARGIN):
        return _refusal(c, nodes, a, b), []
    overlap, residual = float(match.overlap), float(match.residual)
    numbers = {"overlap": overlap, "residual": residual}
    anew = replace(
        c,
        i_from_j=planar_to_matrix(match.pose),
        information=information_from_planar(closure_information(match)),
        source=replace(c.source, overlap=overlap, residual=residual),
        verdicts=(Verdict(Judge.ALIGNMENT, True, Why.MEASURED_ANEW, numbers),),
    )
    if not _fits(anew, nodes, row):
        return _refusal(c, nodes, a, b), []
    return Verdict(Judge.ALIGNMENT, False, Why.MEASURED_ANEW, numbers), [anew]


def _refusal(c: Constraint, nodes: LaserNodes, a: int, b: int) -> Verdict:
    miss = _miss(matrix_to_planar(c.i_from_j), nodes, a, b)
    numbers = {
        "metres": float(np.hypot(*miss[:2])), "degrees": float(np.degrees(abs(miss[2])))
    }  # fmt: skip
    return Verdict(Judge.ALIGNMENT, False, Why.MISSES_ALIGNED, numbers)
