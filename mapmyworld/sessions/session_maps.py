"""What is merged: finished maps, each of one session or several, and what they report of these."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from functools import cached_property

import numpy as np

import mapmyworld
from mapmyworld.config import Config
from mapmyworld.errors import MapError
from mapmyworld.geometry import Array
from mapmyworld.geometry.planar import matrix_to_planar
from mapmyworld.sensing.plan import moves_in_plane
from mapmyworld.types import MapStore, Node


@dataclass(frozen=True, eq=False)
class SessionMap:
    """A finished map to be joined with others."""

    name: str
    store: MapStore
    nodes: tuple[Node, ...]
    solved: Array
    """(N, 4, 4) poses of the nodes, in the session map's own frame."""
    planar: bool

    @cached_property
    def poses(self) -> Array:
        """(N, 3) of `solved`."""
        return matrix_to_planar(self.solved)

    @property
    def sessions(self) -> tuple[int, ...]:
        """Its sessions, in their order."""
        return tuple(sorted({node.session for node in self.nodes}))

    @property
    def order(self) -> tuple[int, bytes]:
        """Sorts session maps the same way however they were given: by time, then by content."""
        first = self.nodes[0]
        return first.stamp_ns, np.stack([n.tracked_from_base for n in self.nodes]).tobytes()


def load_session_map(name: str, store: MapStore) -> SessionMap:
    """A map as a session map; raises `MapError` where it is not finished."""
    nodes, poses = store.nodes(), store.poses()
    if not nodes or poses is None or store.frame_poses() is None:
        raise MapError(f"{name}: is not finished: build it to its end before it is merged")
    at = {int(i): row for row, i in enumerate(poses.ids)}
    solved = np.stack([poses.map_from_node[at[node.id]] for node in nodes])
    planar = moves_in_plane(store)
    return SessionMap(name, store, nodes, solved, planar)


def digest_of(stores: Sequence[MapStore], config: Config) -> str:
    """What went in: the logs, what people stated, the settings; not the names of the files."""
    logs = [((store.get("log") or {}).get("hash"), store.get("edits")) for store in stores]
    text = json.dumps([mapmyworld.__version__, "merge", logs, asdict(config)], default=str)
    return hashlib.sha256(text.encode()).hexdigest()


def note_sessions(store: MapStore, session_maps: Sequence[SessionMap], inputs: str) -> None:
    """Which logs the session maps were made of, in their order."""
    logs = [session_map.store.get("log") or {} for session_map in session_maps]
    paths = [path for log in logs for path in log.get("paths", ())]
    listed = [
        entry
        for session_map, log in zip(session_maps, logs, strict=True)
        for entry in _entries(session_map, log)
    ]
    store.put("log", {"hash": inputs, "paths": paths})
    store.put("sessions", listed)


def _entries(session_map: SessionMap, log: dict[str, object]) -> list[dict[str, object]]:
    """What is known of a session map's sessions: a merged map lists its own."""
    known = session_map.store.get("sessions")
    if known:
        return list(known)
    return [
        {"log": log.get("hash"), "paths": log.get("paths", []), "nodes": len(session_map.nodes)}
    ]
