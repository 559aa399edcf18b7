"""How kinds of constraints are drawn: the known ones as chosen, any other one as well."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TypeVar

from mapmyworld.types import ConstraintKind

Look = TypeVar("Look")
_ELSEWHERE = {ConstraintKind.NEIGHBOUR, ConstraintKind.PRIOR}  # the path, and what is no line


def with_other_kinds(
    looks: Mapping[ConstraintKind, Look], other: Look
) -> dict[ConstraintKind, Look]:
    """`looks` with `other` for every further kind that joins two places, so that none is hidden."""
    others = [kind for kind in ConstraintKind if kind not in _ELSEWHERE.union(looks)]
    return {**looks, **dict.fromkeys(others, other)}
