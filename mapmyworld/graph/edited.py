"""What an edit came to: the constraints it changed, the nodes it moved, what contradicts it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from mapmyworld.backend.residuals import chi_squared_quantile
from mapmyworld.graph.audit import ConstraintResidual, residuals_against
from mapmyworld.types import Constraint, Judged, Poses
from mapmyworld.types.wording import name_of_ends

_CONFIDENCE = 0.999  # of statements that are true fit within the limit
_GREW = 1.0  # sigmas by which a constraint must fit worse than before to count as strained
Key = tuple[str, int, int, int]


@dataclass(frozen=True, slots=True)
class Change:
    """A constraint whose verdict is another than before the edit."""

    constraint: Judged
    what: str
    """accepted, rejected, or no longer found."""


@dataclass(frozen=True, slots=True)
class Strain:
    """A constraint that fits worse than before the edit."""

    constraint: Judged
    before: float
    """Sigmas by which it was missed."""
    after: float


def changes(before: Sequence[Judged], after: Sequence[Judged]) -> list[Change]:
    """Constraints that were accepted and are not, or the other way round; a person's own first."""
    old, new = _by_key(before), _by_key(after)
    found = [
        Change(c, "accepted" if c.accepted else "rejected")
        for key, c in new.items()
        if c.accepted != (key in old and old[key].accepted)
    ]
    found += [Change(c, "no longer found") for k, c in old.items() if c.accepted and k not in new]
    return sorted(found, key=lambda change: not change.constraint.is_by_hand)


def _by_key(constraints: Sequence[Judged]) -> dict[Key, Judged]:
    """By kind and ends, and by number where two nodes have several of a kind."""
    found: dict[Key, Judged] = {}
    for c in constraints:
        number = 0
        while (key := (str(c.kind), c.from_id, c.to_id, number)) in found:
            number += 1
        found[key] = c
    return found


def farthest_moved(before: Poses, after: Poses) -> tuple[int, float]:
    """The node that moved farthest, and by how many metres."""
    ids, old, new = np.intersect1d(before.ids, after.ids, return_indices=True)
    shift = after.map_from_node[new][:, :3, 3] - before.map_from_node[old][:, :3, 3]
    metres = np.linalg.norm(shift, axis=1)
    worst = int(np.argmax(metres))
    return int(ids[worst]), float(metres[worst])


def contradicted(constraints: Sequence[Judged], poses: Poses, planar: bool) -> list[str]:
    """What a person stated and the solved graph does not meet, one line each."""
    limit = float(np.sqrt(chi_squared_quantile(_CONFIDENCE, 3 if planar else 6)))
    stated = [c for c in constraints if c.is_by_hand and c.accepted]
    unmet = [
        m for m in residuals_against(stated, poses, planar) if m is not None and m.sigmas > limit
    ]
    return [_contradiction(residual, limit) for residual in unmet]


def _contradiction(residual: ConstraintResidual, limit: float) -> str:
    return (
        f"{name_of(residual.constraint)}, stated by hand, is contradicted by the rest of the "
        f"graph: residual {residual.metres:.3g} m, {residual.degrees:.1f} deg "
        f"({residual.sigmas:.1f} sigma, limit {limit:.1f}): correct the edit, give it a larger "
        "sigma, or reject what is wrong"
    )


def strained(
    before: tuple[Sequence[Judged], Poses],
    after: tuple[Sequence[Judged], Poses],
    planar: bool,
) -> list[Strain]:
    """Measured constraints that were accepted and fit worse now, the most strained first.

    They fight what was stated: the solution gave way to it at their cost, or rejected them for it.
    """
    old = _sigmas(before[0], before[1], planar)
    found = [
        Strain(m.constraint, old[key], m.sigmas)
        for key, m in _measured(*after, planar).items()
        if key in old and m.sigmas > old[key] + _GREW
    ]
    return sorted(found, key=lambda one: one.before - one.after)


def _sigmas(constraints: Sequence[Judged], poses: Poses, planar: bool) -> Mapping[Key, float]:
    found = _measured(constraints, poses, planar)
    return {key: residual.sigmas for key, residual in found.items() if residual.constraint.accepted}


def _measured(
    constraints: Sequence[Judged], poses: Poses, planar: bool
) -> dict[Key, ConstraintResidual]:
    """Constraints that no person made or judged, against the poses."""
    keyed = {k: c for k, c in _by_key(constraints).items() if not c.is_by_hand}
    residuals = residuals_against(list(keyed.values()), poses, planar)
    return {
        k: residual for k, residual in zip(keyed, residuals, strict=True) if residual is not None
    }


def name_of(constraint: Constraint) -> str:
    """Its kind and its nodes, as `inspect graph` names it, too."""
    return name_of_ends(constraint.kind, constraint.from_id, constraint.to_id)
