"""Several finished maps as one, or as few as they connect to."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from contextlib import AbstractContextManager
from dataclasses import dataclass

import numpy as np

from mapmyworld.backend.connected_components import components
from mapmyworld.config import Config
from mapmyworld.geometry import Array
from mapmyworld.geometry.rigid import invert
from mapmyworld.graph.edited_constraints import edits_to_json
from mapmyworld.sessions.copying import (
    copied_constraints,
    copied_edits,
    copy_drives,
    copy_plan,
    place_session_maps,
)
from mapmyworld.sessions.joining import join_session_maps, tie_sessions
from mapmyworld.sessions.session_maps import SessionMap, digest_of, note_sessions
from mapmyworld.stages.draw_maps import draw_maps
from mapmyworld.stages.recognise import scan_loader
from mapmyworld.stages.solve_and_judge import solve_and_judge
from mapmyworld.types import MapStore, Progress


@dataclass(frozen=True, slots=True)
class MergedMap:
    """One of the maps that resulted."""

    names: tuple[str, ...]
    """Of the maps that went into it, in its order."""
    sessions: int
    nodes: int
    links: int
    """Accepted constraints between different sessions."""


def merge_maps(
    session_maps: Sequence[SessionMap],
    new_store: Callable[[], AbstractContextManager[MapStore]],
    config: Config,
    progress: Progress,
    *,
    first: str | None = None,
) -> list[MergedMap]:
    """One map of every group of session maps that connect, the one with the most nodes first.

    Instead that of the one named `first`, where there is one. The order in which they are
    given does not matter. `new_store` gives an empty map for each.
    """
    ordered = sorted(session_maps, key=lambda session_map: session_map.order)
    joints = join_session_maps(ordered, config, progress)
    ends = np.array(list(joints), np.int64).reshape(-1, 2)
    part = components(len(ordered), *ends.T)
    groups = [np.flatnonzero(part == k).tolist() for k in range(int(part.max()) + 1)]
    wanted = {k for k, session_map in enumerate(ordered) if session_map.name == first}
    sizes = [len(session_map.nodes) for session_map in ordered]
    groups.sort(key=lambda g: (not wanted & set(g), -sum(sizes[k] for k in g), g))
    merged = []
    for group in groups:
        with new_store() as store:
            merged.append(_merge(ordered, group, joints, store, config, progress))
    return merged


def _merge(
    session_maps: Sequence[SessionMap],
    group: Sequence[int],
    joints: dict[tuple[int, int], Array],
    store: MapStore,
    config: Config,
    progress: Progress,
) -> MergedMap:
    placed = place_session_maps([session_maps[k] for k in group], _common_poses(group, joints))
    inputs = digest_of([session_maps[k].store for k in group], config)
    note_sessions(store, [session_maps[k] for k in group], inputs)
    progress.stage("copy", len(group), "sessions")
    with store.write_stage("plan", inputs):
        copy_plan([item.session_map.store for item in placed], store)
    with store.write_stage("track", inputs):
        copy_drives(placed, store)
    scans = scan_loader(store, config)
    joined = [(group.index(a), group.index(b)) for a, b in joints if b in group]
    with store.write_stage("recognise", inputs):
        store.add_constraints(copied_constraints(placed))
        store.add_constraints(tie_sessions(placed, joined, scans, config))
    if edits := copied_edits(placed):
        store.put("edits", edits_to_json(edits))
        progress.note(f"{len(edits)} edits of the maps are carried over")
    with store.write_stage("optimise", inputs):
        solve_and_judge(store, config, progress, scans)
    with store.write_stage("map", inputs):
        draw_maps(store, config, progress)
    nodes = store.nodes()
    session_of = {node.id: node.session for node in nodes}
    links = sum(
        c.accepted and session_of.get(c.from_id) != session_of.get(c.to_id)
        for c in store.constraints()
        if c.to_id > 0
    )
    names = tuple(session_maps[k].name for k in group)
    return MergedMap(names, len({n.session for n in nodes}), len(nodes), links)


def _common_poses(group: Sequence[int], joints: dict[tuple[int, int], Array]) -> list[Array]:
    """Where each session map's frame lies in that of the group's first, along the joints."""
    known: dict[int, Array] = {group[0]: np.eye(4)}
    waiting = [(earlier, later) for earlier, later in joints if later in group]
    while waiting:
        earlier, later = next((a, b) for a, b in waiting if a in known or b in known)
        waiting.remove((earlier, later))
        if earlier in known:
            known[later] = known[earlier] @ joints[earlier, later]
        else:
            known[earlier] = known[later] @ invert(joints[earlier, later])
    return [known[k] for k in group]
