"""Every figure of a map by a name that stays: what `inspect --format json` prints, flattened."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from mapmyworld.types import ConstraintKind, MapStore

_NO_FIGURES = (
    "id",
    "first",
    "last",
    "from",
    "to",
    "hash",
    "rejected_reasons",
    "worst",
    "corrections",
)


def figures_of(store: MapStore) -> dict[str, float]:
    """Dotted name -> value: `map.grid.free_m2`, `graph.constraints.loop_closure.accepted`, ...

    A list counts: `graph.components.count`. A truth is 1 or 0. Kinds of constraints that were never
    tried count as zero. Unsolved maps have no figures of the graph.
    """
    from cli.inspect_map import map_facts

    found = flattened({"map": map_facts(store)})
    poses = store.poses()
    for kind in ConstraintKind:
        for verdict in ("tried", "accepted", "rejected"):
            found[f"graph.constraints.{kind}.{verdict}"] = 0.0
    if poses is not None:
        from cli.inspect_graph import facts_of_map

        found |= flattened({"graph": facts_of_map(store, poses, None, 10)})
    return found


def flattened(value: Any, name: str = "") -> dict[str, float]:
    """Numbers of nested JSON values by dotted name; of lists their length."""
    if isinstance(value, Mapping):
        found: dict[str, float] = {}
        for key, inner in value.items():
            if key not in _NO_FIGURES:
                found |= flattened(inner, f"{name}.{key}" if name else str(key))
        return found
    if isinstance(value, bool | int | float | np.number):
        return {name: float(value)} if np.isfinite(value) else {}
    if isinstance(value, list | tuple):
        return {f"{name}.count": float(len(value))}
    return {}


def problems_of(store: MapStore) -> list[str]:
    """What the map lacks, one line each; empty for a whole map."""
    reported: list[str] = [] if store.poses() is not None else ["the graph was not solved"]
    for key in ("plan", "track", "solve"):
        reported += (store.get(key) or {}).get("losses", ())
    reported += getattr(store, "problems", ())
    return list(dict.fromkeys(reported))
