"""A person's edits worked into a finished map: the graph is solved and the grid drawn anew."""

from __future__ import annotations

from collections.abc import Sequence

from mapmyworld.config import Config
from mapmyworld.errors import GraphError, MapError
from mapmyworld.graph.edited_constraints import edits_to_json, resolve_pins, unmet
from mapmyworld.stages.draw_maps import draw_maps
from mapmyworld.stages.recognise import scan_loader
from mapmyworld.stages.solve_and_judge import solve_and_judge
from mapmyworld.types import MapStore, Progress
from mapmyworld.types.edits import Edit


def edit_map(
    store: MapStore, edits: Sequence[Edit], config: Config, progress: Progress
) -> tuple[str, ...]:
    """Replaces the edits that the map has by these, as `build` would; what it then lacks.

    Raises `MapError` where the map is not solved, `GraphError` where edits do not fit it.
    """
    poses = store.poses()
    if poses is None:
        raise MapError("its graph is not solved yet: finish `build` first")
    resolved = resolve_pins(edits, poses)
    if problems := unmet(store.constraints(), resolved):
        raise GraphError("the edits do not fit this map:", problems=problems)
    store.put("edits", edits_to_json(resolved))
    with store.write_stage("optimise", "edit"):  # anew, as `build` does: without what it found
        solve_and_judge(store, config, progress, scan_loader(store, config))
    with store.write_stage("map", "edit"):
        draw_maps(store, config, progress)
    return tuple((store.get("solve") or {}).get("losses", ()))
