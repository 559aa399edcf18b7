"""What a person wants to know about a solved graph: counts, residuals, corrections, connection."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from mapmyworld.backend.connected_components import positions
from mapmyworld.backend.residuals import edge_residuals, squared_sigmas
from mapmyworld.geometry import Array
from mapmyworld.geometry.planar import PLANAR_IN_TANGENT, information_to_planar
from mapmyworld.geometry.rigid import between
from mapmyworld.geometry.rotations import rotation_angle
from mapmyworld.types import OF_ONE_NODE, ConstraintKind, Judged, Poses

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
    order = np.argsort(poses.ids, kind="stable")
    known = poses.ids[order]
    found: list[ConstraintResidual | None] = [None] * len(constraints)
    ends = np.array([(c.from_id, c.to_id) for c in constraints], np.int64).reshape(-1, 2)
    places = positions(known, ends.ravel()).reshape(-1, 2)
    sound = np.array(
        [np.isfinite(c.i_from_j).all() and np.isfinite(c.information).all() for c in constraints],
        np.bool_,
    )
    usable = np.flatnonzero((places >= 0).all(axis=1) & sound)
    if len(usable) == 0:
        return tuple(found)
    matrices = poses.map_from_node[order]
    tails = matrices[places[usable, 0]]
    tails[ends[usable, 0] == ends[usable, 1]] = np.eye(4)
    heads = matrices[places[usable, 1]]
    measured = np.array([constraints[k].i_from_j for k in usable.tolist()])
    information = np.array([constraints[k].information for k in usable.tolist()])
    residuals = edge_residuals(False, tails, heads, measured)
    if planar:
        residuals, information = residuals[:, PLANAR_IN_TANGENT], information_to_planar(information)
    chi2 = np.maximum(squared_sigmas(residuals, information), 0.0)
    error = between(measured, between(tails, heads))
    metres = np.linalg.norm(error[:, :3, 3], axis=1)
    degrees = np.degrees(rotation_angle(error))
    for n, k in enumerate(usable.tolist()):
        found[k] = ConstraintResidual(
            constraints[k], float(metres[n]), float(degrees[n]), float(chi2[n] ** 0.5)
        )
    return tuple(found)


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
