"""A person's edits, applied to constraints; the same edits always give the same result."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mapmyworld.errors import GraphError
from mapmyworld.types import (
    Constraint,
    ConstraintKind,
    Judge,
    Judged,
    Person,
    Poses,
    Verdict,
    Why,
)
from mapmyworld.types.edits import Edit, EditAction

_STATEMENTS = {
    EditAction.ACCEPT: Verdict(Judge.PERSON, True, Why.ACCEPTED_BY_HAND),
    EditAction.REJECT: Verdict(Judge.PERSON, False, Why.REJECTED_BY_HAND),
}
_PIN_SIGMA = (1e-4, 1e-4, 1e-4, 1e-3, 1e-3, 1e-3)  # rad, m


def apply_edits(constraints: Sequence[Judged], edits: Sequence[Edit]) -> tuple[Judged, ...]:
    """The constraints as these edits want them; earlier edits that are not among them are undone.

    Edits of constraints that are not there, or not yet, change nothing.
    """
    result = list(as_found(constraints))
    for edit in edits:
        if edit.action in _STATEMENTS:
            verdict = replace(_STATEMENTS[edit.action], note=edit.reason)
            result = [c.judged(verdict) if _concerns(edit, c) else c for c in result]
        else:
            result.append(_made(edit))
    return tuple(result)


def as_found(constraints: Sequence[Judged]) -> tuple[Judged, ...]:
    """What was measured, as its finders judged it: nothing that a person stated or a graph says."""
    return tuple(c.before(Judge.PERSON) for c in constraints if not isinstance(c.source, Person))


def unmet(constraints: Sequence[Constraint], edits: Sequence[Edit]) -> list[str]:
    """What of the edits accepts or rejects a constraint that does not exist, one line each."""
    return [
        f"{edit.action}: no {f'{edit.kind} ' if edit.kind else ''}constraint between "
        f"{edit.from_id} and {edit.to_id}"
        for edit in edits
        if edit.action in _STATEMENTS and not any(_concerns(edit, c) for c in constraints)
    ]


def resolve_pins(edits: Sequence[Edit], poses: Poses) -> tuple[Edit, ...]:
    """The edits with the present pose written into every pin that gives none.

    So that a replay pins the node where it was when the person looked at it. Raises `GraphError`
    where an edit names a node without pose.
    """
    at = {int(k): pose for k, pose in zip(poses.ids, poses.map_from_node, strict=True)}
    unknown = sorted({i for e in edits for i in (e.from_id, e.to_id)} - set(at))
    if unknown:
        raise GraphError(
            "the edits do not fit this map:", problems=[f"no node {i}" for i in unknown]
        )
    return tuple(
        replace(e, motion=at[e.from_id]) if e.action is EditAction.PIN and e.motion is None else e
        for e in edits
    )


def edits_to_json(edits: Sequence[Edit]) -> list[dict[str, Any]]:
    """Plain values for the store."""
    return [
        {name.removesuffix("_id"): _plain(value) for name, value in asdict(edit).items()}
        for edit in edits
    ]


def _plain(value: Any) -> Any:
    return value.tolist() if isinstance(value, np.ndarray) else value


def edits_from_json(value: Sequence[Mapping[str, Any]] | None) -> tuple[Edit, ...]:
    """The edits of a store; none from None."""
    return tuple(
        Edit(
            EditAction(item["action"]),
            int(item["from"]),
            int(item["to"]),
            item["reason"],
            item["kind"],
            *(item[k] and np.array(item[k]) for k in ("motion", "covariance")),
        )
        for item in value or ()
    )


def _concerns(edit: Edit, constraint: Constraint) -> bool:
    ends = {constraint.from_id, constraint.to_id}
    return (
        ends == {edit.from_id, edit.to_id}
        and not isinstance(constraint.source, Person)
        and (not edit.kind or constraint.kind == edit.kind)
    )


def covariance_of(edit: Edit) -> NDArray[np.float64]:
    """(6, 6), rotation first, of an addition, a prior or a pin."""
    return np.diag(np.square(_PIN_SIGMA)) if edit.covariance is None else edit.covariance


def _made(edit: Edit) -> Judged:
    assert edit.motion is not None
    kind = ConstraintKind.USER if edit.action is EditAction.ADD else ConstraintKind.PRIOR
    return Judged(
        edit.from_id,
        edit.to_id,
        kind,
        np.asarray(edit.motion),
        np.asarray(np.linalg.inv(covariance_of(edit)), np.float64),
        Person(edit.action, edit.reason),
    )
