"""What a person wants to know about a solved graph: counts, residuals, corrections, connection."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from mapmyworld.backend.system import edge_chi2, missed_by
from mapmyworld.geometry import Array
from mapmyworld.graph.constraint_system import stated_system
from mapmyworld.types import OF_ONE_NODE, Constraint, ConstraintKind, Judged, Poses

_OVERCONFIDENT = 2.0  # times larger than stated: errors from which a kind is called over-confident


@dataclass(frozen=True, slots=True, eq=False)
class ConstraintResidual:
    """One constraint against the solution."""

    constraint: Judged
    metres: float
    degrees: float
    sigmas: float


def residuals_against(
    constraints: Sequence[Judged], poses: Poses, planar: bool
) -> tuple[ConstraintResidual | None, ...]:
    """Every constraint against the solved poses, accepted or not; None where a node is missing."""
    known = set(poses.ids.tolist())
    found: list[ConstraintResidual | None] = [None] * len(constraints)
    used = [k for k, c in enumerate(constraints) if {c.from_id, c.to_id} <= known and _is_finite(c)]
    chosen = [constraints[k] for k in used]
    stated = stated_system(poses.ids, poses.map_from_node, chosen, planar)
    sigmas = np.sqrt(np.maximum(edge_chi2(stated.system, stated.start), 0.0))
    missed = missed_by(stated.system, stated.start)
    for k, *numbers in zip(used, *missed, sigmas, strict=True):
        found[k] = ConstraintResidual(constraints[k], *map(float, numbers))
    return tuple(found)


def _is_finite(constraint: Constraint) -> bool:
    measured, information = constraint.i_from_j, constraint.information
    return bool(np.isfinite(measured).all() and np.isfinite(information).all())


def counts_of(constraints: Sequence[Judged]) -> dict[str, dict[str, int]]:
    """Kind -> how many were tried, accepted and rejected."""
    result: dict[str, dict[str, int]] = {}
    for kind in ConstraintKind:
        mine = [c for c in constraints if c.kind == kind]
        if mine:
            good = sum(c.accepted for c in mine)
            result[str(kind)] = {
                "tried": len(mine),
                "accepted": good,
                "rejected": len(mine) - good,
            }
    return result


def is_overconfident(residual: float, factor: float) -> bool:
    """Whether a kind stated too much, by its normalised residual after its variance factor."""
    return bool(residual * np.sqrt(factor) > _OVERCONFIDENT)


def corrections_of(
    residuals: Sequence[ConstraintResidual | None], start: Poses
) -> tuple[tuple[ConstraintResidual, float, float], ...]:
    """Accepted closures with the metres and degrees by which the start had missed them.

    `start` holds the poses by tracking alone; largest first.
    """
    tied = OF_ONE_NODE | {ConstraintKind.NEIGHBOUR}
    closures = [
        r for r in residuals if r and r.constraint.accepted and r.constraint.kind not in tied
    ]
    missed = residuals_against([r.constraint for r in closures], start, planar=False)
    found = [
        (r, before.metres, before.degrees)
        for r, before in zip(closures, missed, strict=True)
        if before
    ]
    return tuple(sorted(found, key=lambda item: -item[1]))


def uncertainty_of(poses: Poses) -> dict[str, Any] | None:
    """Largest and median one-sigma of position (m) and rotation (deg); None when not computed."""
    if poses.covariances is None or len(poses.covariances) == 0:
        return None
    metres, degrees = sigmas_of(poses.covariances)
    worst = int(np.argmax(metres))
    return {
        "median_metres": float(np.median(metres)),
        "median_degrees": float(np.median(degrees)),
        "largest_metres": float(metres[worst]),
        "largest_degrees": float(degrees.max()),
        "largest_at": int(poses.ids[worst]),
    }


def sigmas_of(covariances: Array) -> tuple[Array, Array]:
    """One-sigma radii of position, metres, and rotation, degrees, (N,) both.

    By covariances (N, 6, 6), rotation first.
    """
    variances = np.maximum(np.einsum("nii->ni", covariances), 0.0)
    metres = np.sqrt(variances[:, 3:].sum(axis=1))
    return metres, np.degrees(np.sqrt(variances[:, :3].sum(axis=1)))
