"""Constraints and verdicts as rows: ours, and RTAB-Map's links of the accepted ones."""

from __future__ import annotations

import functools
import json
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import fields
from typing import Any, get_args

import numpy as np

from formats.database.blobs import doubles, information_to_blobs
from formats.database.connection import Row
from formats.nested_text import json_from_text
from mapmyworld.errors import MapError
from mapmyworld.geometry.rigid import invert
from mapmyworld.types import (
    OF_ONE_NODE,
    Constraint,
    ConstraintKind,
    Judge,
    Judged,
    Source,
    Verdict,
    Why,
)

INSERT_LINK = (
    "INSERT INTO Link (from_id, to_id, type, information_matrix, transform) VALUES (?,?,?,?,?)"
)
INSERT_CONSTRAINT = (
    "INSERT INTO mapmyworld_constraints (id, rank, from_id, to_id, kind, i_from_j, information,"
    " source, figures) VALUES (?,?,?,?,?,?,?,?,?)"
)
INSERT_VERDICT = (
    "INSERT INTO mapmyworld_verdicts (constraint_id, rank, judge, accepted, why, numbers, note)"
    " VALUES (?,?,?,?,?,?,?)"
)
SELECT_CONSTRAINTS = (
    "SELECT from_id, to_id, kind, i_from_j, information, source, figures, id"
    " FROM mapmyworld_constraints ORDER BY id"
)
SELECT_VERDICTS = (
    "SELECT constraint_id, judge, accepted, why, numbers, note FROM mapmyworld_verdicts ORDER BY id"
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
# Those of RTAB-Map which are relative poses between nodes, distinguished as far as ours are:
# closures in time are proximity, merged neighbours are neighbours.
KINDS = {number: kind for kind, number in LINK_TYPES.items()} | {
    3: ConstraintKind.PROXIMITY,
    6: ConstraintKind.NEIGHBOUR,
}
# Stored once: what it links to has no row of its own.
_ONE_WAY = OF_ONE_NODE | {ConstraintKind.LANDMARK}
_SOURCES = {source.__name__: source for source in get_args(Source)}
_TYPES: Mapping[str, Any] = {"float": int | float, "int": int, "bool": bool, "str": str}


def link_rows(constraints: Iterable[Judged]) -> Iterator[Row]:
    """RTAB-Map's links of the accepted constraints, both directions where it keeps both."""
    accepted = [c for c in constraints if c.accepted]
    motions = np.array([c.i_from_j for c in accepted]).reshape(-1, 4, 4)
    weights = np.array([c.information for c in accepted]).reshape(-1, 6, 6)
    there, back = (m[:, :3].astype("<f4") for m in (motions, invert(motions)))
    blobs = zip(accepted, information_to_blobs(weights), there, back, strict=True)
    for c, information, to_blob, from_blob in blobs:
        other = LINK_TYPES[ConstraintKind.PRIOR] if c.kind in OF_ONE_NODE else _VIRTUAL
        kind = LINK_TYPES.get(c.kind, other)
        yield (c.from_id, c.to_id, kind, information, to_blob.tobytes())
        if c.kind not in _ONE_WAY:
            # RTAB-Map keeps the information of the forward link for the backward one.
            yield (c.to_id, c.from_id, kind, information, from_blob.tobytes())


def constraint_rows(numbered: Iterable[tuple[int, int, Constraint]]) -> Iterator[Row]:
    """Our own rows, in double precision, of constraints with their id and their stage's rank."""
    for constraint_id, rank, c in numbered:
        yield (
            constraint_id,
            rank,
            c.from_id,
            c.to_id,
            str(c.kind),
            np.asarray(c.i_from_j, "<f8").tobytes(),
            np.asarray(c.information, "<f8").tobytes(),
            type(c.source).__name__,
            json.dumps({item.name: getattr(c.source, item.name) for item in fields(c.source)}),
        )


def verdict_rows(numbered: Iterable[tuple[int, int, Verdict]]) -> Iterator[Row]:
    """Rows of verdicts with the id of their constraint and their stage's rank."""
    for constraint_id, rank, v in numbered:
        numbers = json.dumps(dict(v.numbers))
        yield (constraint_id, rank, str(v.judge), int(v.accepted), str(v.why), numbers, v.note)


def verdicts_from_rows(rows: Iterable[Row]) -> dict[int, tuple[Verdict, ...]]:
    """Id of a constraint -> the verdicts of rows of `SELECT_VERDICTS`."""
    found: dict[int, tuple[Verdict, ...]] = {}
    for constraint_id, *row in rows:
        found[constraint_id] = (*found.get(constraint_id, ()), _verdict(constraint_id, *row))
    return found


def _verdict(
    constraint_id: int, judge: Any, accepted: Any, why: Any, numbers: Any, note: Any
) -> Verdict:
    try:
        figures = json_from_text(numbers)
        if not (isinstance(note, str) and isinstance(figures, dict)):
            raise TypeError("a note or figures of another type")
        if not all(isinstance(figure, int | float) for figure in figures.values()):
            raise TypeError("a figure that is no number")
        return Verdict(Judge(judge), bool(accepted), Why(why), figures, note)
    except (ValueError, TypeError) as error:
        raise MapError(
            f"a verdict on constraint {constraint_id}: a damaged row ({error})"
        ) from None


def constraint_from_row(row: Row, verdicts: Mapping[int, tuple[Verdict, ...]]) -> Judged:
    """The constraint of a row of `SELECT_CONSTRAINTS`; raises `MapError` where it is damaged."""
    from_id, to_id, kind, transform, information, source, figures, constraint_id = row
    try:
        if not (isinstance(from_id, int) and isinstance(to_id, int)):
            raise TypeError("an id that is no whole number")
        return Judged(
            from_id,
            to_id,
            ConstraintKind(kind),
            doubles(transform, 4),
            doubles(information, 6),
            _source(source, figures),
            verdicts.get(constraint_id, ()),
        )
    except (ValueError, TypeError) as error:
        raise MapError(f"constraint {from_id} to {to_id}: a damaged row ({error})") from None


@functools.lru_cache(maxsize=4096)  # most of those of a long drive are alike
def _source(name: str, figures: str) -> Source:
    if name not in _SOURCES:
        raise ValueError(f"an unknown source {name!r}")
    found: Source = _SOURCES[name](**json_from_text(figures))
    for item in fields(found):
        if not isinstance(getattr(found, item.name), _TYPES[str(item.type)]):
            raise TypeError(f"{item.name} is of another type")
    return found
