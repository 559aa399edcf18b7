"""A finished map taken further: new sessions are laid into it, at a cost of their own only.

The map is held where it is, reduced to its skeleton; the new session is solved and aligned against
that, like a merge of two. Where the session contradicts the map, all must be solved anew.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from mapmyworld.config import Config
from mapmyworld.geometry import Array
from mapmyworld.geometry.planar import planar_to_matrix
from mapmyworld.geometry.rigid import between, invert, se3_adjoint, transported
from mapmyworld.graph.edited_constraints import as_found
from mapmyworld.graph.frame_poses import pose_every_frame
from mapmyworld.map_figures import contradictions_of
from mapmyworld.mapping.occupancy import added_grid, build_grid
from mapmyworld.places.session_joining import locate_session
from mapmyworld.sessions.copying import Placed, copied_constraints, copy_drives, copy_plan
from mapmyworld.sessions.joining import has_laser, session_places, tie_sessions
from mapmyworld.sessions.session_maps import (
    SessionMap,
    digest_of,
    load_session_map,
    note_sessions,
    skeleton_of,
)
from mapmyworld.stages.draw_maps import draw_maps, scans_at
from mapmyworld.stages.kept import has_images
from mapmyworld.stages.recognise import scan_loader
from mapmyworld.stages.solve_and_judge import note_solution, solve_and_judge
from mapmyworld.types import Judged, MapStore, Poses, Progress, Why

_CONTRADICTING = 0.2  # share of a session's closures with the map from which it contradicts it


@dataclass(frozen=True, slots=True, eq=False)
class Extension:
    """What became of the session maps that were to be added."""

    added: tuple[SessionMap, ...]
    """In the order in which they were."""
    apart: tuple[SessionMap, ...]
    """Those that show another place."""
    links: int
    """Accepted constraints between the added sessions and those before them."""


def extend_map(
    store: MapStore,
    session_maps: Sequence[SessionMap],
    new_store: Callable[[], MapStore],
    config: Config,
    progress: Progress,
) -> Extension | None:
    """Lays session maps into a finished map, in an order of their own; None where that does not do.

    `new_store` gives an empty map, in which a session is solved against what is held of the known.
    It does not for maps that keep images, whose words are those of all sessions, and for a session
    that contradicts the map. The store has then been changed and must be given up.
    """
    waiting, links = sorted(session_maps, key=lambda session_map: session_map.order), 0
    added: list[SessionMap] = []
    if any(
        has_images(one) for one in (store, *(session_map.store for session_map in session_maps))
    ):
        return None
    while True:
        base = load_session_map("", store)
        found = _first_that_joins(base, waiting, config, progress)
        if found is None:
            return Extension(tuple(added), tuple(waiting), links)
        session_map, joint = found
        laid = _lay(base, session_map, joint, new_store, config, progress)
        if laid is None:
            return None
        _write(base, laid, store, config, progress)
        waiting.remove(session_map)
        added.append(session_map)
        links += laid.links


def _first_that_joins(
    base: SessionMap, session_maps: Sequence[SessionMap], config: Config, progress: Progress
) -> tuple[SessionMap, Array] | None:
    """And where its frame (4, 4) lies in that of the map."""
    session_maps = [session_map for session_map in session_maps if has_laser(session_map)]
    if not session_maps or not has_laser(base):
        return None
    progress.stage("join sessions", len(session_maps), "sessions")
    known = session_places(base, config)
    for session_map in session_maps:
        move = locate_session(known, session_places(session_map, config))
        if move is not None:
            return session_map, planar_to_matrix(move)
    return None


@dataclass(frozen=True, slots=True, eq=False)
class _Laid:
    """A session map solved against a map."""

    item: Placed
    poses: Poses
    """Of its nodes, under their ids in the map."""
    constraints: tuple[Judged, ...]
    """Its own and those with the map, judged."""
    links: int
    certainty: str
    losses: tuple[str, ...]
    divides: tuple[int, ...]


def _lay(
    base: SessionMap,
    session_map: SessionMap,
    joint: Array,
    new_store: Callable[[], MapStore],
    config: Config,
    progress: Progress,
) -> _Laid | None:
    """The session map solved against the map's skeleton; None where many closures do not fit."""
    skeleton = skeleton_of(base, new_store(), config)
    item = Placed(session_map, joint, base.nodes[-1].id, max(base.sessions) + 1)
    placed, scratch = [Placed(skeleton, np.eye(4), 0, 0), item], new_store()
    with scratch.write_stage("plan", ""):
        copy_plan([base.store, session_map.store], scratch)
    with scratch.write_stage("track", ""):
        copy_drives(placed, scratch)
    scans = scan_loader(scratch, config)
    with scratch.write_stage("recognise", ""):
        scratch.add_constraints(copied_constraints(placed))
        scratch.add_constraints(tie_sessions(placed, [(0, 1)], scans, config))
    with scratch.write_stage("optimise", ""):
        solve_and_judge(scratch, config, progress, scans, since=item.first_id + 1)
    mine = [c for c in scratch.constraints() if item.first_id < max(c.from_id, c.to_id)]
    across = [c for c in mine if 0 < min(c.from_id, c.to_id) <= item.first_id]
    accepted = sum(c.accepted for c in across)
    against = sum(any(v.why is Why.CONTRADICTS for v in c.verdicts) for c in across)
    if against > _CONTRADICTING * (accepted + against):
        return None
    solved = scratch.get("solve") or {}
    poses = _held_poses(scratch, skeleton, base, item)
    # The components of the skeleton and the session map are counted in the whole map.
    reported = str(solved.get("certainty", "")), tuple(contradictions_of(solved))
    divides = tuple(i for i in solved.get("divides", ()) if i > item.first_id)
    return _Laid(item, poses, tuple(mine), accepted, *reported, divides)


def _held_poses(scratch: MapStore, skeleton: SessionMap, base: SessionMap, item: Placed) -> Poses:
    """The session map's poses as seen from the nearest node of the map, put back where it was.

    A node is as uncertain as that node of the map and the motion between the two.
    """
    found = scratch.poses()
    assert found is not None
    new = found.ids > item.first_id
    held = np.stack([node.tracked_from_base for node in skeleton.nodes])
    moved = found.map_from_node[~new]
    solved = found.map_from_node[new]
    apart = np.linalg.norm(solved[:, None, :2, 3] - moved[None, :, :2, 3], axis=2)
    nearest = np.argmin(apart, axis=1)
    from_held = between(moved[nearest], solved)
    poses = held[nearest] @ from_held
    known = base.store.poses()
    covariances = None
    if found.covariances is not None and known is not None and known.covariances is not None:
        row_of = {int(i): row for row, i in enumerate(known.ids)}
        rows = np.array([row_of[skeleton.nodes[k].id] for k in nearest])
        carry = se3_adjoint(invert(from_held))
        covariances = transported(carry, known.covariances[rows]) + found.covariances[new]
    return Poses(found.ids[new], poses, covariances)


def _write(
    base: SessionMap, laid: _Laid, store: MapStore, config: Config, progress: Progress
) -> None:
    """Adds what was laid to the map: nothing that it holds is read again, or moved."""
    session_map = laid.item.session_map
    progress.stage("copy", 1, "sessions")
    before, frame_poses, judged = store.poses(), store.frame_poses(), store.constraints()
    assert before is not None
    assert frame_poses is not None
    solved = store.get("solve") or {}
    inputs = digest_of([store, session_map.store], config)
    note_sessions(store, [base, session_map], inputs)
    with store.extend_stage("plan", inputs):
        copy_plan([store, session_map.store], store)
    with store.extend_stage("track", inputs):
        copy_drives([laid.item], store)
    with store.extend_stage("recognise", inputs):
        store.add_constraints(as_found(laid.constraints))
    with store.extend_stage("optimise", inputs):
        store.judge((*judged, *laid.constraints))
        landmarks = before.ids < 0  # which come last
        nodes_first = before.chosen(~landmarks).followed_by(laid.poses, before.chosen(landmarks))
        store.set_poses(nodes_first)
        own = session_map.store.tracked_frames()
        own = replace(own, node_ids=own.node_ids + laid.item.first_id)
        nodes = [node for node in store.nodes() if node.id > laid.item.first_id]
        fresh = pose_every_frame(nodes, laid.poses, own, laid.constraints)
        store.set_frame_poses(np.concatenate([frame_poses, fresh]))
        losses = list(dict.fromkeys((*contradictions_of(solved), *laid.losses)))
        divides = [*solved.get("divides", ()), *laid.divides]
        notes, noise = solved.get("notes", ()), solved.get("scan_noise", ())
        note_solution(store, laid.certainty, losses, notes, divides, noise)
    with store.extend_stage("map", inputs):
        known, scans = store.grid(), scans_at(session_map.store, np.arange(len(fresh)), fresh)
        more = build_grid(scans, config, fresh[:, :2, 3])
        total = None if known is None else added_grid(known, more, config)
        if total is None:
            draw_maps(store, config, progress)
        else:
            store.set_grid(total)
