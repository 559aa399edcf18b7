"""Which units show the same place, and how they lie to each other."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from mapmyworld.config import Config
from mapmyworld.geometry.planar import planar_to_matrix
from mapmyworld.places.laser_nodes import load_node_scans, nodes_at
from mapmyworld.places.session_joining import Joint, SessionMap, find_joints, locate_session
from mapmyworld.sessions import joining_by_images as by_images
from mapmyworld.sessions.units import Unit
from mapmyworld.stages.kept import has_scans
from mapmyworld.types import Progress

Array = NDArray[np.float64]


def join_units(units: list[Unit], config: Config, progress: Progress) -> list[Joint]:
    """For each unit one earlier unit of every group that it belongs to."""
    maps = [session_map(unit, config) if _has_laser(unit) else None for unit in units]
    progress.stage("join sessions", len(units), "sessions")

    def locate(earlier: int, later: int) -> Array | None:
        progress.update(later)
        a, b = maps[earlier], maps[later]
        if a is None or b is None:
            return by_images.locate_unit(units[earlier], units[later], config)
        move = locate_session(a, b)
        return None if move is None else planar_to_matrix(move)

    return find_joints(len(units), locate)


def have_scans(a: Unit, b: Unit) -> bool:
    """Whether a laser drew both."""
    return _has_laser(a) and _has_laser(b)


def _has_laser(unit: Unit) -> bool:
    return unit.planar and has_scans(unit.store)


def session_map(unit: Unit, config: Config) -> SessionMap:
    """What a unit's laser saw, at its final poses."""
    nodes = nodes_at(load_node_scans(unit.store, config), unit.store.poses())
    return SessionMap(nodes, np.arange(len(nodes.ids)), config)
