"""Sessions of one log, joined by loop closures between places that both saw."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from mapmyworld.config import Config
from mapmyworld.geometry.planar import (
    between_planar,
    compose_planar,
    information_from_planar,
    planar_to_matrix,
)
from mapmyworld.places.laser_candidates import NEAR, SLACK
from mapmyworld.places.laser_closures import compare_places
from mapmyworld.places.laser_nodes import LaserNodes
from mapmyworld.places.node_drift import SIGMAS
from mapmyworld.places.session_joining import LossPrior, locate_session
from mapmyworld.places.session_places import SessionPlaces
from mapmyworld.types import ConstraintKind, Judged, Progress

Pair = tuple[int, int, int, int]
"""First row and number of nodes of an earlier session, and of a later one."""


def session_closures(
    nodes: LaserNodes, config: Config, progress: Progress, apart: set[Pair]
) -> list[Judged]:
    """Closures between two sessions of these nodes, the first two that are recognised.

    Losses of tracking divide them; `apart` are pairs that are known not to join, and learns more.
    """
    numbers = np.unique(nodes.session)
    maps = [SessionPlaces(nodes, np.flatnonzero(nodes.session == n), config) for n in numbers]
    drift = replace(nodes.drift, faults=True)
    progress.stage("join sessions", len(maps), "sessions")
    for k, later in enumerate(maps):
        progress.update(k)
        for earlier in reversed(maps[:k]):
            pair = _pair(earlier, later)
            if pair in apart:
                continue
            found = _joined(earlier, later, LossPrior(drift, earlier, later), config)
            if any(c.accepted for c in found):
                return found
            apart.add(pair)
    return []


def _pair(earlier: SessionPlaces, later: SessionPlaces) -> Pair:
    a, b = earlier.rows, later.rows
    return int(a[0]), len(a), int(b[0]), len(b)


def _joined(
    earlier: SessionPlaces, later: SessionPlaces, prior: LossPrior, config: Config
) -> list[Judged]:
    move = locate_session(earlier, later, prior)
    if move is None:
        return []
    poses = later.nodes.poses.copy()
    poses[later.rows] = compose_planar(move, poses[later.rows])
    moved = replace(later.nodes, poses=poses)
    return closures_between(moved, earlier, SessionPlaces(moved, later.rows, config), config)


def closures_between(
    nodes: LaserNodes, earlier: SessionPlaces, later: SessionPlaces, config: Config
) -> list[Judged]:
    """Places of two sessions that lie near each other at these nodes' poses, compared.

    The sessions lie as they were found to, but for the slack of solved poses.
    """
    pairs = _near_pairs(nodes, earlier, later)
    if not pairs:
        return []
    tails, heads = np.array(pairs).T
    steps = between_planar(nodes.poses[tails], nodes.poses[heads])
    k = int(np.argmin(np.hypot(steps[:, 0], steps[:, 1])))
    known = information_from_planar(np.diag(np.square(SIGMAS / np.array([SLACK[0], *SLACK]))))
    (a, b), pose = nodes.ids[list(pairs[k])].tolist(), planar_to_matrix(steps[k])
    joint = Judged(a, b, ConstraintKind.LOOP_CLOSURE, pose, known)
    drift = replace(nodes.drift, poses=nodes.poses, stated=(*nodes.drift.stated, joint))
    return compare_places(replace(nodes, drift=drift), pairs, config)


def _near_pairs(
    nodes: LaserNodes, earlier: SessionPlaces, later: SessionPlaces
) -> list[tuple[int, int]]:
    """(earlier, later) nodes, for each place of the later session the nearest one."""
    seeing = earlier.rows[nodes.sees[earlier.rows]]
    pairs = []
    for k in later.spots:
        apart = np.hypot(*(nodes.poses[seeing, :2] - nodes.poses[k, :2]).T)
        if len(apart) and apart.min() < NEAR:
            ends = sorted((int(seeing[np.argmin(apart)]), k))
            pairs.append((ends[0], ends[1]))
    return pairs
