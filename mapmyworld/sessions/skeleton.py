"""A finished map reduced to one node a place and heading, each held where it is."""

from __future__ import annotations

import itertools
from dataclasses import replace

import numpy as np

from mapmyworld.config import Config
from mapmyworld.geometry.planar import information_from_planar, matrix_to_planar
from mapmyworld.geometry.rigid import between
from mapmyworld.localisation.known_place import spread_out
from mapmyworld.sessions.session_maps import SessionMap
from mapmyworld.types import ConstraintKind, Judged, MapStore, Node, NodeData
from mapmyworld.types.frames import nodes_as_frames

_HELD = information_from_planar(np.diag([1e6, 1e6, 1e8]))  # 1 mm and 0.1 mrad
_RIGID = information_from_planar(np.diag([1e8, 1e8, 1e10]))  # 0.1 mm and 0.01 mrad a step


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
            between(a.tracked_from_base, b.tracked_from_base), _RIGID,
        )
        for a, b in itertools.pairwise(nodes)
    ]  # fmt: skip
    return held + steps
