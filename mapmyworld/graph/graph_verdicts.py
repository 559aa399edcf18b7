"""What the solved graph judges of every constraint."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from mapmyworld.backend.system import System, missed_by
from mapmyworld.geometry import Array, Index
from mapmyworld.graph.robust import RobustSolution
from mapmyworld.parallel import batches
from mapmyworld.types import Constraint, Judge, Judged, Verdict, Why

_BLOCK = 2048  # constraints whose matrices are looked at together


def faults_of(constraints: Sequence[Constraint], known: set[int]) -> list[str]:
    """Why each constraint cannot be used at all; empty where it can."""
    found: list[str] = []
    for some in batches(constraints, _BLOCK):
        information = information_faults(np.stack([c.information for c in some]))
        finite = np.asarray(np.isfinite([c.i_from_j for c in some]).all(axis=(1, 2)))
        for c, sound, reported in zip(some, finite, information, strict=True):
            if missing := {c.from_id, c.to_id} - known:
                found.append(f"node {min(missing)} does not exist")
            else:
                found.append(reported if sound else "its measurement is not a number")
    return found


def information_faults(information: Array) -> list[str]:
    """Why matrices (K, d, d) are no information matrices; empty where they are."""
    finite = np.asarray(np.isfinite(information).all(axis=(1, 2)))
    sound = np.where(finite[:, None, None], information, 0.0)
    scale = np.abs(sound).max(axis=(1, 2), initial=0.0)
    lopsided = np.abs(sound - np.swapaxes(sound, 1, 2)).max(axis=(1, 2), initial=0.0)
    smallest = np.linalg.eigvalsh(sound)[:, 0]
    names = np.select(
        [~finite, lopsided > 1e-6 * scale, (scale == 0.0) | (smallest <= 1e-15 * scale)],
        [
            "its information is not a number",
            "its information matrix is not symmetric",
            "its information matrix is not positive definite",
        ],
        "",
    )
    return [str(name) for name in names]


def judged(
    constraints: Sequence[Judged],
    faults: Sequence[str],
    used: Index,
    solution: RobustSolution,
    system: System,
) -> tuple[Judged, ...]:
    """All constraints, those that were asked with the graph's verdict.

    `used` (E,) are the positions of those that are the system's edges.
    """
    result = [
        c.judged(Verdict(Judge.GRAPH, False, Why.UNUSABLE, note=fault)) if fault else c
        for c, fault in zip(constraints, faults, strict=True)
    ]
    metres, degrees = missed_by(system, solution.poses)
    closure_at = {int(k): n for n, k in enumerate(solution.closures)}
    for place, k in enumerate(used.tolist()):
        missed = float(metres[place]), float(degrees[place])
        verdict = _verdict(solution, place, closure_at.get(place), missed)
        result[k] = result[k].judged(verdict)
    return tuple(result)


def _verdict(
    solution: RobustSolution, place: int, closure: int | None, missed: tuple[float, float]
) -> Verdict:
    """On the edge at a `place`, which is that `closure`, if it is one, `missed` by (m, deg)."""
    sigmas, limit = float(np.sqrt(solution.chi2[place])), float(np.sqrt(solution.limit))
    numbers = {
        "residual_metres": missed[0],
        "residual_degrees": missed[1],
        "sigmas": sigmas,
        "sigmas_limit": limit,
    }
    if closure is None:
        return Verdict(Judge.GRAPH, bool(solution.inliers[place]), Why.FITS, numbers)
    numbers["supporters"] = int(solution.consistency.supporters[closure])
    numbers["partners"] = int(solution.consistency.partners[closure])
    if solution.inliers[place]:
        return Verdict(Judge.GRAPH, True, Why.FITS, numbers)
    why = Why.UNSUPPORTED if sigmas <= limit else Why.CONTRADICTS
    return Verdict(Judge.GRAPH, False, why, numbers)
