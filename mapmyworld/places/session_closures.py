"""Sessions of one log, joined by loop closures between places that both saw."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from mapmyworld.config import Config
from mapmyworld.geometry.planar import compose_planar
from mapmyworld.places.laser_closures import compare_places
from mapmyworld.places.laser_nodes import LaserNodes
from mapmyworld.places.session_joining import SessionPlaces, find_joints, locate_session
from mapmyworld.types import ConstraintKind, Judged, Progress

Array = NDArray[np.float64]
_NEAR = 3.0  # m between two places that see the same


def session_closures(nodes: LaserNodes, config: Config, progress: Progress) -> list[Judged]:
    """Closures between the sessions of these nodes, as far as they are recognised."""
    numbers = np.unique(nodes.session)
    maps = [SessionPlaces(nodes, np.flatnonzero(nodes.session == n), config) for n in numbers]
    progress.stage("join sessions", len(maps), "sessions")

    def locate(earlier: int, later: int) -> Array | None:
        progress.update(later)
        return locate_session(maps[earlier], maps[later])

    closures = []
    for joint in find_joints(len(maps), locate):
        later = maps[joint.later]
        poses = nodes.poses.copy()
        poses[later.rows] = compose_planar(joint.earlier_from_later, poses[later.rows])
        moved = replace(nodes, poses=poses)
        later = SessionPlaces(moved, later.rows, config)
        closures += closures_between(moved, maps[joint.earlier], later, config)
    return closures


def closures_between(
    nodes: LaserNodes, earlier: SessionPlaces, later: SessionPlaces, config: Config
) -> list[Judged]:
    """Places of two sessions that lie near each other at these nodes' poses, compared."""
    pairs = _near_pairs(nodes, earlier, later)
    found = compare_places(nodes, pairs, config, optimised=True)
    return [replace(c, kind=ConstraintKind.LOOP_CLOSURE) for c in found]


def _near_pairs(
    nodes: LaserNodes, earlier: SessionPlaces, later: SessionPlaces
) -> list[tuple[int, int]]:
    """(earlier, later) nodes, for each place of the later session the nearest one."""
    seeing = earlier.rows[nodes.sees[earlier.rows]]
    pairs = []
    for k in later.spots:
        apart = np.hypot(*(nodes.poses[seeing, :2] - nodes.poses[k, :2]).T)
        if len(apart) and apart.min() < _NEAR:
            ends = sorted((int(seeing[np.argmin(apart)]), k))
            pairs.append((ends[0], ends[1]))
    return pairs
