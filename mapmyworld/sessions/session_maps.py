"""Finished maps of one or several sessions that are to be merged; one reduced to its skeleton."""

from __future__ import annotations

import hashlib
import itertools
import json
from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace

import numpy as np

import mapmyworld
from mapmyworld.config import Config
from mapmyworld.errors import MapError
from mapmyworld.geometry import Array
from mapmyworld.geometry.planar import information_from_planar, matrix_to_planar
from mapmyworld.geometry.rigid import between
from mapmyworld.localisation.known_place import spread_out
from mapmyworld.sensing.plan import moves_in_plane
from mapmyworld.types import ConstraintKind, Judged, MapStore, Node, NodeData
from mapmyworld.types.frames import nodes_as_frames

_HELD = information_from_planar(np.diag([1e6, 1e6, 1e8]))  # 1 mm and 0.1 mrad


@dataclass(frozen=True, slots=True, eq=False)
class SessionMap:
    """A finished map to be joined with others."""

    name: str
    store: MapStore
    nodes: tuple[Node, ...]
    solved: Array
    """(N, 4, 4) poses of the nodes, in the session map's own frame."""
    planar: bool

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
    at = dict(zip(poses.ids.tolist(), poses.map_from_node, strict=True))
    solved = np.stack([at[node.id] for node in nodes])
    return SessionMap(name, store, nodes, solved, moves_in_plane(store))


def digest_of(stores: Sequence[MapStore], config: Config) -> str:
    """What went in: the logs, what people stated, the settings; not the names of the files."""
    logs = [((store.get("log") or {}).get("hash"), store.get("edits")) for store in stores]
    text = json.dumps([mapmyworld.__version__, "merge", logs, asdict(config)], default=str)
    return hashlib.sha256(text.encode()).hexdigest()


def note_sessions(store: MapStore, session_maps: Sequence[SessionMap], inputs: str) -> None:
    """Which logs the session maps were made of, in their order; a merged map lists its own."""
    logs = [session_map.store.get("log") or {} for session_map in session_maps]
    paths = [path for log in logs for path in log.get("paths", ())]
    listed = list[dict[str, object]]()
    for one, log in zip(session_maps, logs, strict=True):
        own = {"log": log.get("hash"), "paths": log.get("paths", []), "nodes": len(one.nodes)}
        listed += one.store.get("sessions") or [own]
    store.put("log", {"hash": inputs, "paths": paths})
    store.put("sessions", listed)


def skeleton_of(base: SessionMap, store: MapStore, config: Config) -> SessionMap:
    """The session map's nodes that are left, under their ids, with their scans, as a map in an
    empty `store`.

    Their number grows with the area that was seen, not with how often it was.
    """
    frames = base.store.tracked_frames()
    poses = base.store.frame_poses()
    assert poses is not None
    at_nodes = np.flatnonzero(frames.is_node)
    chosen = spread_out(matrix_to_planar(poses), at_nodes, config.localisation.spacing)
    known = {node.id: node for node in base.nodes}
    nodes = list[Node]()
    with store.write_stage("plan", ""):
        store.put("plan", {"planar": base.planar})
    with store.write_stage("track", ""):
        for frame, scan in base.store.scans(chosen):
            node = known[int(frames.node_ids[frame])]
            nodes.append(replace(node, session=0, tracked_from_base=poses[frame]))
            store.add_node(nodes[-1], NodeData(scan=scan))
            store.add_scan(len(nodes) - 1, scan)
        store.set_tracked_frames(nodes_as_frames(nodes))
    with store.write_stage("recognise", ""):
        store.add_constraints(_ties(nodes))
    solved = np.array([node.tracked_from_base for node in nodes]).reshape(-1, 4, 4)
    return SessionMap(base.name, store, tuple(nodes), solved, base.planar)


def _ties(nodes: list[Node]) -> list[Judged]:
    """Every node to the map, for the graph, and to the next one, for the alignment of scans."""
    held = [
        Judged(node.id, node.id, ConstraintKind.PRIOR, node.tracked_from_base, _HELD)
        for node in nodes
    ]
    steps = [
        Judged(
            a.id, b.id, ConstraintKind.NEIGHBOUR,
            between(a.tracked_from_base, b.tracked_from_base), _HELD,
        )
        for a, b in itertools.pairwise(nodes)
    ]  # fmt: skip
    return held + steps
