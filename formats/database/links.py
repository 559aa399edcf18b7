"""Constraints as rows: ours, with verdict and reason, and RTAB-Map's links of the accepted ones."""

from __future__ import annotations

import json
import sys
from collections.abc import Iterable, Iterator, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from formats.database.blobs import doubles, information_to_blob, pose_to_blob, stacked_doubles
from formats.nested_text import json_from_text
from mapmyworld.errors import MapError
from mapmyworld.geometry.rigid import invert
from mapmyworld.types import Constraint, ConstraintKind

INSERT_LINK = (
    "INSERT INTO Link (from_id, to_id, type, information_matrix, transform) VALUES (?,?,?,?,?)"
)
INSERT_CONSTRAINT = (
    "INSERT INTO mapmyworld_constraints (rank, from_id, to_id, kind, from_from_to, information,"
    " accepted, reason, evidence) VALUES (?,?,?,?,?,?,?,?,?)"
)
SELECT_CONSTRAINTS = (
    "SELECT from_id, to_id, kind, from_from_to, information, accepted, reason, evidence"
    " FROM mapmyworld_constraints WHERE rank >= ? ORDER BY id"
)
LINK_TYPES = {
    ConstraintKind.NEIGHBOUR: 0,
    ConstraintKind.LOOP_CLOSURE: 1,
    ConstraintKind.PROXIMITY: 2,
    ConstraintKind.USER: 4,
    ConstraintKind.PRIOR: 7,
    ConstraintKind.LANDMARK: 8,
}
_VIRTUAL = 5  # RTAB-Map's "virtual closure": any other relative pose
# Those of RTAB-Map which are relative poses between nodes, told apart as far as ours are:
# closures in time are proximity, merged neighbours are neighbours.
KINDS = {number: kind for kind, number in LINK_TYPES.items()} | {
    3: ConstraintKind.PROXIMITY,
    6: ConstraintKind.NEIGHBOUR,
}
# Stored once: what it links to has no row of its own.
_ONE_WAY = {ConstraintKind.PRIOR, ConstraintKind.LANDMARK}
Row = tuple[Any, ...]


def link_rows(constraints: Iterable[Constraint]) -> Iterator[Row]:
    """RTAB-Map's links of the accepted constraints, both directions where it keeps both."""
    accepted = [c for c in constraints if c.accepted]
    backwards = invert(np.array([c.from_from_to for c in accepted]).reshape(-1, 4, 4))
    for c, to_from_from in zip(accepted, backwards, strict=True):
        kind, information = LINK_TYPES.get(c.kind, _VIRTUAL), information_to_blob(c.information)
        yield (c.from_id, c.to_id, kind, information, pose_to_blob(c.from_from_to))
        if c.kind not in _ONE_WAY:
            # RTAB-Map keeps the information of the forward link for the backward one.
            yield (c.to_id, c.from_id, kind, information, pose_to_blob(to_from_from))


def constraint_rows(ranked: Iterable[tuple[Constraint, int]]) -> Iterator[Row]:
    """Our own rows, in double precision, of constraints with their stage's rank."""
    for c, rank in ranked:
        yield (
            rank,
            c.from_id,
            c.to_id,
            str(c.kind),
            np.asarray(c.from_from_to, "<f8").tobytes(),
            np.asarray(c.information, "<f8").tobytes(),
            int(c.accepted),
            c.reason,
            json.dumps(dict(c.evidence), default=float) if c.evidence else "{}",
        )


def constraints_from_rows(rows: Sequence[Row]) -> Iterator[Constraint]:
    """The constraints of rows of `SELECT_CONSTRAINTS`."""
    transforms = stacked_doubles([row[3] for row in rows], 4)
    informations = stacked_doubles([row[4] for row in rows], 6)
    if transforms is None or informations is None:
        yield from map(constraint_from_row, rows)
        return
    for row, transform, information in zip(rows, transforms, informations, strict=True):
        yield _constraint(row, transform, information)


def constraint_from_row(row: Row) -> Constraint:
    """The constraint of a row of `SELECT_CONSTRAINTS`."""
    try:
        return _constraint(row, doubles(row[3], 4), doubles(row[4], 6))
    except (ValueError, TypeError) as error:
        raise MapError(f"constraint {row[0]} to {row[1]}: a damaged row ({error})") from None


def _constraint(
    row: Row, transform: NDArray[np.float64], information: NDArray[np.float64]
) -> Constraint:
    from_id, to_id, kind, _, _, accepted, reason, evidence = row
    try:
        if not (isinstance(from_id, int) and isinstance(to_id, int)):
            raise TypeError("an id that is no whole number")
        return Constraint(
            from_id,
            to_id,
            ConstraintKind(kind),
            transform,
            information,
            bool(accepted),
            sys.intern(reason),  # most are alike
            {} if evidence == "{}" else json_from_text(evidence, object_pairs_hook=_figures),
        )
    except (ValueError, TypeError) as error:
        raise MapError(f"constraint {from_id} to {to_id}: a damaged row ({error})") from None


def _figures(pairs: Sequence[tuple[str, float]]) -> dict[str, float]:
    return {sys.intern(name): value for name, value in pairs}
