"""The looks of kinds of constraints, the same in every picture; unknown kinds are drawn as well."""

from __future__ import annotations

from mapmyworld.types import OF_ONE_NODE, ConstraintKind

PATH, REJECTED = "#1f6fd1", "#8a8f98"
_NAMED = {
    ConstraintKind.NEIGHBOUR: PATH,
    ConstraintKind.LOOP_CLOSURE: "#d7301f",
    ConstraintKind.PROXIMITY: "#00875f",
    ConstraintKind.USER: "#b0409a",
    ConstraintKind.LANDMARK: "#8a6d00",
}
_OTHERS = [kind for kind in ConstraintKind if kind not in OF_ONE_NODE.union(_NAMED)]
COLOURS = {**_NAMED, **dict.fromkeys(_OTHERS, "#5c4b8a")}
"""Of every kind that joins two places, so that none is hidden."""
