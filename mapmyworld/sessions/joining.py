"""Which sessions show the same place, and how they lie to each other."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from mapmyworld.config import Config
from mapmyworld.geometry.planar import planar_to_matrix
from mapmyworld.places.laser_nodes import load_node_scans, nodes_at
from mapmyworld.places.session_joining import Joint, SessionPlaces, find_joints, locate_session
from mapmyworld.places.wide_search import held_by
from mapmyworld.sessions import joining_by_images as by_images
from mapmyworld.sessions.session_maps import SessionMap
from mapmyworld.stages.kept import has_scans
from mapmyworld.types import Progress

Array = NDArray[np.float64]


def join_session_maps(
    session_maps: list[SessionMap], config: Config, progress: Progress
) -> list[Joint]:
    """For each session one earlier session of every group that it belongs to."""
    maps = [
        session_places(session_map, config) if _has_laser(session_map) else None
        for session_map in session_maps
    ]
    progress.stage("join sessions", len(session_maps), "sessions")

    def locate(earlier: int, later: int) -> Array | None:
        progress.update(later)
        a, b = maps[earlier], maps[later]
        if a is None or b is None:
            return by_images.locate_session_map(session_maps[earlier], session_maps[later], config)
        move = locate_session(a, b)
        return None if move is None else planar_to_matrix(move)

    return find_joints(len(session_maps), locate)


def have_scans(a: SessionMap, b: SessionMap) -> bool:
    """Whether a laser drew both."""
    return _has_laser(a) and _has_laser(b)


def _has_laser(session_map: SessionMap) -> bool:
    return session_map.planar and has_scans(session_map.store)


def session_places(session_map: SessionMap, config: Config) -> SessionPlaces:
    """What a session's laser saw, at its final poses."""
    store = session_map.store
    nodes = nodes_at(load_node_scans(store, config), store.poses())
    return SessionPlaces(held_by(nodes, store.constraints()), np.arange(len(nodes.ids)), config)
