"""A person's edits, applied to constraints; the same edits always give the same result."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from mapmyworld.errors import GraphError
from mapmyworld.graph.verdicts import unjudged
from mapmyworld.types import Constraint, ConstraintKind, Poses
from mapmyworld.types.edits import BY_HAND, Edit, EditAction

_STATEMENTS = (EditAction.ACCEPT, EditAction.REJECT)
_BEFORE = "accepted_before_edit"
_MARK = "by hand: "
_PIN_SIGMA = (1e-4, 1e-4, 1e-4, 1e-3, 1e-3, 1e-3)  # rad, m


def apply_edits(constraints: Sequence[Constraint], edits: Sequence[Edit]) -> tuple[Constraint, ...]:
    """The constraints as these edits want them; earlier edits that are not among them are undone.

    Edits of constraints that are not there, or not yet, change nothing.
    """
    result = [_unedited(c) for c in constraints if c.evidence.get(BY_HAND) != 2.0]
    for edit in edits:
        if edit.action in _STATEMENTS:
            result = [_stated(c, edit) if _concerns(edit, c) else c for c in result]
        else:
            result.append(_made(edit))
    return tuple(result)


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

    So that a replay pins the node where it was when the person looked at it.
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
        {
            "action": str(e.action),
            "from": e.from_id,
            "to": e.to_id,
            "reason": e.reason,
            "kind": e.kind,
            "motion": None if e.motion is None else np.asarray(e.motion).tolist(),
            "covariance": None if e.covariance is None else np.asarray(e.covariance).tolist(),
        }
        for e in edits
    ]


def edits_from_json(value: Sequence[Mapping[str, Any]] | None) -> tuple[Edit, ...]:
    """The edits of a store; none from None."""
    return tuple(
        Edit(
            EditAction(item["action"]),
            int(item["from"]),
            int(item["to"]),
            item["reason"],
            item["kind"],
            None if item["motion"] is None else np.array(item["motion"]),
            None if item["covariance"] is None else np.array(item["covariance"]),
        )
        for item in value or ()
    )


def _concerns(edit: Edit, constraint: Constraint) -> bool:
    ends = {constraint.from_id, constraint.to_id}
    return (
        ends == {edit.from_id, edit.to_id}
        and constraint.evidence.get(BY_HAND) != 2.0
        and (not edit.kind or constraint.kind == edit.kind)
    )


def _stated(constraint: Constraint, edit: Edit) -> Constraint:
    word = "accepted" if edit.action is EditAction.ACCEPT else "rejected"
    evidence = constraint.evidence
    before = float(constraint.accepted or "sigmas" in evidence)  # what the graph rejected counts
    statement = f"{_MARK}{word}: {edit.reason}"
    return replace(
        constraint,
        accepted=edit.action is EditAction.ACCEPT,
        reason=" | ".join(part for part in (_measured(constraint), statement) if part),
        evidence={_BEFORE: before, **evidence, BY_HAND: 1.0},
    )


def _unedited(constraint: Constraint) -> Constraint:
    """The constraint as it was measured, and judged by nobody, where a person had judged it."""
    if constraint.evidence.get(BY_HAND) != 1.0:
        return constraint
    constraint = unjudged(constraint)  # else what was measured to be false passes for judged so
    kept = {k: v for k, v in constraint.evidence.items() if k not in (BY_HAND, _BEFORE)}
    return replace(
        constraint,
        accepted=bool(constraint.evidence[_BEFORE]),
        reason=_measured(constraint),
        evidence=kept,
    )


def _measured(constraint: Constraint) -> str:
    """The reason without what people said."""
    return " | ".join(p for p in constraint.reason.split(" | ") if not p.startswith(_MARK))


def _made(edit: Edit) -> Constraint:
    assert edit.motion is not None
    covariance = edit.covariance
    if covariance is None:
        covariance = np.diag(np.square(_PIN_SIGMA))
    kind = ConstraintKind.USER if edit.action is EditAction.ADD else ConstraintKind.PRIOR
    return Constraint(
        edit.from_id,
        edit.to_id,
        kind,
        np.asarray(edit.motion),
        np.asarray(np.linalg.inv(covariance), np.float64),
        True,
        f"{_MARK}{edit.action}: {edit.reason}",
        {BY_HAND: 2.0},
    )
