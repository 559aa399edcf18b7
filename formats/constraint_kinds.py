"""The looks of kinds of constraints, the same in every picture; unknown kinds are drawn as well."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TypeVar

from mapmyworld.types import OF_ONE_NODE, ConstraintKind

Look = TypeVar("Look")
_ELSEWHERE = OF_ONE_NODE | {ConstraintKind.NEIGHBOUR}  # the path, and what is no line
PATH, REJECTED = "#1f6fd1", "#8a8f98"


def with_other_kinds(
    looks: Mapping[ConstraintKind, Look], other: Look
) -> dict[ConstraintKind, Look]:
    """`looks` with `other` for every further kind that joins two places, so that none is hidden."""
    others = [kind for kind in ConstraintKind if kind not in _ELSEWHERE.union(looks)]
    return {**looks, **dict.fromkeys(others, other)}


COLOURS = with_other_kinds(
    {
        ConstraintKind.NEIGHBOUR: PATH,
        ConstraintKind.LOOP_CLOSURE: "#d7301f",
        ConstraintKind.PROXIMITY: "#00875f",
        ConstraintKind.USER: "#b0409a",
        ConstraintKind.LANDMARK: "#8a6d00",
    },
    "#5c4b8a",
)


def rgb(colour: str) -> tuple[int, int, int]:
    """Red, green and blue, 0 to 255, of "#rrggbb"."""
    return int(colour[1:3], 16), int(colour[3:5], 16), int(colour[5:7], 16)
