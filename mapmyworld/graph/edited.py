"""What an edit came to: the constraints it changed, the nodes it moved, what contradicts it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from mapmyworld.graph.audit import ConstraintResidual, residuals_against
from mapmyworld.types import Constraint, Judged, Person, Poses
from mapmyworld.types.wording import name_of_ends

_LIMIT = 3.0  # of its sigmas by which the final poses may miss what a person stated
_GREW = 1.0  # sigmas by which a constraint must fit worse than before to count as strained
_NAMED = 3  # constraints that a contradiction names
Key = tuple[str, int, int, bytes, int]


@dataclass(frozen=True, slots=True)
class Change:
    """A constraint whose verdict is another than before the edit."""

    constraint: Judged
    what: str
    """accepted, rejected, or no longer found."""


@dataclass(frozen=True, slots=True)
class Strain:
    """A constraint that fits worse than without what was stated."""

    constraint: Judged
    before: float
    """Sigmas by which it is missed without that."""
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
    """By kind, ends and what a person stated, and by number where several are alike."""
    found: dict[Key, Judged] = {}
    for c in constraints:
        made = isinstance(c.source, Person)
        stated = c.i_from_j.tobytes() + c.information.tobytes() if made else b""
        number = 0
        while (key := (str(c.kind), c.from_id, c.to_id, stated, number)) in found:
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


def contradicted(
    constraints: Sequence[Judged], poses: Poses, planar: bool
) -> list[ConstraintResidual]:
    """What a person stated and the poses miss by more than three of its sigmas, the worst first."""
    stated = [c for c in constraints if c.is_by_hand and c.accepted]
    known = [m for m in residuals_against(stated, poses, planar) if m is not None]
    return sorted((m for m in known if m.sigmas > _LIMIT), key=lambda m: -m.sigmas)


def strained(
    before: tuple[Sequence[Judged], Poses],
    after: tuple[Sequence[Judged], Poses],
    planar: bool,
) -> list[Strain]:
    """Constraints that were accepted and fit worse now: what else was stated, then the worst first.

    They fight what is new: the solution gave way to it at their cost, or rejected them for it.
    """
    old = {k: m.sigmas for k, m in _residuals(*before, planar).items() if m.constraint.accepted}
    found = [
        Strain(c, old[key], m.sigmas)
        for key, m in _residuals(*after, planar).items()
        if key in old and m.sigmas > old[key] + _GREW
        if (c := m.constraint).accepted or not c.is_by_hand
    ]
    return sorted(found, key=lambda one: (not one.constraint.is_by_hand, one.before - one.after))


def _residuals(
    constraints: Sequence[Judged], poses: Poses, planar: bool
) -> dict[Key, ConstraintResidual]:
    keyed = _by_key(constraints)
    residuals = residuals_against(list(keyed.values()), poses, planar)
    return {k: m for k, m in zip(keyed, residuals, strict=True) if m is not None}


def contradiction(residual: ConstraintResidual, fought: Sequence[Strain]) -> str:
    """The line about a statement that is not met, with the constraints that stand against it."""
    named = ", ".join(in_sigmas(one) for one in fought[:_NAMED])
    if len(fought) > _NAMED:
        named += f" and {len(fought) - _NAMED} more"
    return (
        f"{name_of(residual.constraint)}, stated by hand, is contradicted by the rest of the "
        f"graph: residual {residual.metres:.3g} m, {residual.degrees:.1f} deg "
        f"({residual.sigmas:.1f} sigma, limit {_LIMIT:.1f}); it fights "
        f"{named or 'no single constraint'}: correct the edit, give it a larger "
        "sigma, or reject what is wrong"
    )


def in_sigmas(strain: Strain) -> str:
    """A strained constraint, without what was stated and with it."""
    rejected = "" if strain.constraint.accepted else ", rejected"
    return (
        f"{name_of(strain.constraint)} ({strain.before:.1f} -> {strain.after:.1f} sigma{rejected})"
    )


def name_of(constraint: Constraint) -> str:
    """Its kind and its nodes, as `inspect graph` names it, too."""
    return name_of_ends(constraint.kind, constraint.from_id, constraint.to_id)
