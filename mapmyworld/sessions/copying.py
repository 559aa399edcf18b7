"""The sessions of several session maps written into one store, in a common frame."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from mapmyworld.geometry import Array
from mapmyworld.geometry.rigid import between, invert, se3_adjoint
from mapmyworld.graph.edited_constraints import as_found, covariance_of, edits_from_json
from mapmyworld.sessions.session_maps import SessionMap
from mapmyworld.types import Judged, MapStore, Node, TrackedFrames
from mapmyworld.types.edits import Edit, EditAction

_PLACES = {EditAction.PIN, EditAction.PRIOR}


@dataclass(frozen=True, slots=True, eq=False)
class Placed:
    """A session map, and where its frame lies in the common one."""

    session_map: SessionMap
    common_from_session_map: Array
    """(4, 4)."""
    first_id: int
    """What its node ids begin after."""
    first_session: int

    def new_id(self, node_id: int) -> int:
        """The id in the merged map; landmarks (negative) keep theirs, for a marker is the same."""
        return node_id + self.first_id if node_id > 0 else node_id


def place_session_maps(
    session_maps: Sequence[SessionMap], common_from_session_map: Sequence[Array]
) -> list[Placed]:
    """The session maps one after the other, with ids and sessions counted on, at poses (4, 4)."""
    placed: list[Placed] = []
    first_id = first_session = 0
    for session_map, pose in zip(session_maps, common_from_session_map, strict=True):
        placed.append(Placed(session_map, pose, first_id, first_session))
        first_id += session_map.nodes[-1].id
        first_session += len(session_map.sessions)
    return placed


def copy_plan(sources: Sequence[MapStore], store: MapStore) -> None:
    """What was decided for the first one that decided anything, role by role, and all losses."""
    plans = [source.get("plan") or {} for source in sources]
    merged: dict[str, Any] = dict(plans[0])
    merged["decisions"] = _decided([plan.get("decisions", ()) for plan in plans])
    for key in ("warnings", "losses"):
        merged[key] = list(dict.fromkeys(line for plan in plans for line in plan.get(key, ())))
    store.put("plan", merged)


def _decided(plans: Sequence[Sequence[dict[str, Any]]]) -> list[dict[str, Any]]:
    """For each role the first choice: a session without a camera decides nothing for others."""
    found: dict[str, dict[str, Any]] = {}
    for decision in (one for plan in plans for one in plan):
        if not found.setdefault(decision["role"], decision)["choice"]:
            found[decision["role"]] = decision
    return list(found.values())


def copy_drives(placed: Sequence[Placed], store: MapStore) -> None:
    """Nodes with their data, all frames with their scans, and the motion within each session.

    They come after those that the store holds.
    """
    known = store.tracked_frames()
    frames = [known] if len(known.stamps_ns) else []
    for item in placed:
        frames.append(_copy_drive(item, store, sum(len(f.stamps_ns) for f in frames)))
    store.set_tracked_frames(frames[0].followed_by(*frames[1:]))
    _note_tracks([store, *(item.session_map.store for item in placed)], store)


def _copy_drive(item: Placed, store: MapStore, first_frame: int) -> TrackedFrames:
    for node, moved in _nodes(item):
        data = item.session_map.store.node_data(node.id)
        features = None if data.features is None else replace(data.features, words=None)
        store.add_node(moved, replace(data, features=features))
    own = item.session_map.store.tracked_frames()
    for frame, scan in item.session_map.store.scans(np.arange(len(own.stamps_ns))):
        store.add_scan(first_frame + frame, scan)
    return replace(own, node_ids=own.node_ids + item.first_id)


def _note_tracks(sources: Sequence[MapStore], store: MapStore) -> None:
    notes = [source.get("track") or {} for source in sources]
    store.put(
        "track",
        {
            "frames": sum(note.get("frames", 0) for note in notes),
            "losses": [line for note in notes for line in note.get("losses", ())],
            "notes": [line for note in notes for line in note.get("notes", ())],
        },
    )


def _nodes(item: Placed) -> list[tuple[Node, Node]]:
    """Each node with what becomes of it: new id and session, tracked in the common frame."""
    sessions = {s: item.first_session + k for k, s in enumerate(item.session_map.sessions)}
    moved: dict[int, Array] = {}
    pairs = []
    for row, node in enumerate(item.session_map.nodes):
        if node.session not in moved:
            # The session's first node goes where the common frame has it; the others follow.
            solved = item.common_from_session_map @ item.session_map.solved[row]
            moved[node.session] = solved @ invert(node.tracked_from_base)
        tracked = moved[node.session] @ node.tracked_from_base
        fresh = replace(
            node,
            id=item.new_id(node.id),
            session=sessions[node.session],
            tracked_from_base=tracked,
        )
        pairs.append((node, fresh))
    return pairs


def copied_constraints(placed: Sequence[Placed]) -> list[Judged]:
    """All that was measured in the session maps, under the new ids, as its finders judged it."""
    return [
        replace(c, from_id=item.new_id(c.from_id), to_id=item.new_id(c.to_id))
        for item in placed
        for c in as_found(item.session_map.store.constraints())
    ]


def copied_edits(placed: Sequence[Placed]) -> tuple[Edit, ...]:
    """Every session map's edits under the new ids.

    Priors and pins say where nodes are in their own session map's frame. That of the first one is
    the merged map's; of the others they still say how their nodes lie to each other.
    """
    return tuple(edit for k, item in enumerate(placed) for edit in _of(item, is_first=k == 0))


def _of(item: Placed, *, is_first: bool) -> Iterator[Edit]:
    edits = [
        replace(edit, from_id=item.new_id(edit.from_id), to_id=item.new_id(edit.to_id))
        for edit in edits_from_json(item.session_map.store.get("edits"))
    ]
    places = [] if is_first else [edit for edit in edits if edit.action in _PLACES]
    yield from (edit for edit in edits if edit not in places)
    yield from (_between(places[0], other) for other in places[1:])


def _between(first: Edit, other: Edit) -> Edit:
    """How one node lies to another, where both were stated in one frame."""
    assert first.motion is not None
    assert other.motion is not None
    motion = between(first.motion, other.motion)
    carry = se3_adjoint(invert(motion))
    covariance = carry @ covariance_of(first) @ carry.T + covariance_of(other)
    return Edit(
        EditAction.ADD, first.from_id, other.from_id, f"{first.reason}; {other.reason}", "",
        motion, np.asarray(covariance),
    )  # fmt: skip
