"""What became of every constraint, in words a user can act on."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from mapmyworld.geometry import Array
from mapmyworld.geometry.rigid import se3_exp
from mapmyworld.geometry.rotations import rotation_angle
from mapmyworld.graph.pose_graph import Index
from mapmyworld.graph.residuals import edge_residuals, planar_exp
from mapmyworld.graph.robust import RobustSolution
from mapmyworld.graph.system import System
from mapmyworld.parallel import batches
from mapmyworld.types import Constraint
from mapmyworld.types.edits import BY_HAND

_BLOCK = 2048  # constraints whose matrices are looked at together
_MARK = "graph: "
_UNUSABLE = "cannot be used: "
_JUDGED = (
    "residual_metres",
    "residual_degrees",
    "sigmas",
    "sigmas_limit",
    "supporters",
    "partners",
    "moved_metres",
    "moved_degrees",
)


def faults_of(constraints: Sequence[Constraint], known: set[int]) -> list[str]:
    """Why each constraint cannot be used at all; empty where it can."""
    found: list[str] = []
    for some in batches(constraints, _BLOCK):
        information = information_faults(np.stack([c.information for c in some]))
        found += [_fault_of(c, known) or told for c, told in zip(some, information, strict=True)]
    return found


def _fault_of(constraint: Constraint, known: set[int]) -> str:
    missing = {constraint.from_id, constraint.to_id} - known
    if missing:
        return f"node {min(missing)} does not exist"
    if not np.isfinite(constraint.from_from_to).all():
        return "its measurement is not a number"
    return ""


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
    constraints: Sequence[Constraint],
    faults: Sequence[str],
    used: Index,
    solution: RobustSolution,
    system: System,
) -> tuple[Constraint, ...]:
    """All constraints with verdict, reason and evidence; `used` are those of the system."""
    result = [
        replace(c, accepted=False, reason=f"{_UNUSABLE}{fault}") if fault else c
        for c, fault in zip(constraints, faults, strict=True)
    ]
    metres, degrees = misfits(system, solution.poses)
    closure_at = {int(k): n for n, k in enumerate(solution.closures)}
    for place, k in enumerate(used.tolist()):
        before, missed = result[k], (float(metres[place]), float(degrees[place]))
        reason, evidence = _judgement(solution, place, closure_at.get(place), missed)
        result[k] = replace(
            before,
            accepted=bool(solution.inliers[place]),
            reason=" | ".join(part for part in (before.reason, _MARK + reason) if part),
            evidence={**before.evidence, **evidence},
        )
    return tuple(result)


def _judgement(
    solution: RobustSolution, place: int, closure: int | None, missed: tuple[float, float]
) -> tuple[str, dict[str, float]]:
    """Reason and evidence of the edge at a `place`, which is that `closure`, if it is one.

    `missed`: metres and degrees.
    """
    sigmas, limit = float(np.sqrt(solution.chi2[place])), float(np.sqrt(solution.limit))
    metres, degrees = missed
    evidence = {
        "residual_metres": metres,
        "residual_degrees": degrees,
        "sigmas": sigmas,
        "sigmas_limit": limit,
    }
    fit = f"misses by {metres:.3g} m, {degrees:.3g} deg = {sigmas:.1f} sigma (limit {limit:.1f})"
    if closure is None:
        return fit, evidence
    supporters = int(solution.consistency.supporters[closure])
    partners = int(solution.consistency.partners[closure])
    evidence |= {"supporters": supporters, "partners": partners}
    if solution.inliers[place]:
        return f"{fit}; {_support(supporters, partners)}", evidence
    if sigmas <= limit:
        return f"nothing supports it and it may fit by chance: {fit}", evidence
    return f"contradicts the rest of the graph: {fit}; {_support(supporters, partners)}", evidence


def unjudged(constraint: Constraint) -> Constraint:
    """The constraint as it was before the graph judged it; what a person stated stays."""
    unusable = constraint.reason.startswith(_UNUSABLE)
    if "sigmas" not in constraint.evidence and not unusable:
        return constraint
    parts = [] if unusable else constraint.reason.split(" | ")
    return replace(
        constraint,
        accepted=constraint.accepted if BY_HAND in constraint.evidence else True,
        reason=" | ".join(part for part in parts if not part.startswith(_MARK)),
        evidence={k: v for k, v in constraint.evidence.items() if k not in _JUDGED},
    )


def _support(supporters: int, partners: int) -> str:
    if partners == 0:
        return "no other closure near it"
    return f"{supporters} of {partners} closures near it agree"


def misfits(system: System, poses: Array) -> tuple[Array, Array]:
    """Metres and degrees (E,) by which every edge is missed."""
    tail, head = poses[system.tails], poses[system.heads]
    residuals = edge_residuals(system.planar, tail, head, system.measured)
    if system.planar:
        motion = planar_exp(residuals)
        return np.linalg.norm(motion[:, :2], axis=1), np.degrees(np.abs(motion[:, 2]))
    motion = se3_exp(residuals)
    return np.linalg.norm(motion[:, :3, 3], axis=1), np.degrees(rotation_angle(motion))
