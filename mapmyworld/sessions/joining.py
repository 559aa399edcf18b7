"""Which units show the same place, and how they lie to each other: one is localised in another."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from mapmyworld.config import Config
from mapmyworld.decisions import decided
from mapmyworld.geometry.planar import (
    between_planar,
    compose_planar,
    invert_planar,
    planar_to_matrix,
)
from mapmyworld.localisation.global_localisation import GlobalLocalisation
from mapmyworld.localisation.known_place import Fit, KnownPlace, known_place_from_store
from mapmyworld.localisation.observation import (
    Moment,
    fit_at,
    is_convincing,
    match_at,
    thinned_points,
)
from mapmyworld.registration.scan_matching import COARSE, prepare_scan
from mapmyworld.sessions import joining_by_images as by_images
from mapmyworld.sessions.session_maps import Joint, SessionMap
from mapmyworld.stages.kept import has_scans
from mapmyworld.types import Progress, Scan

Array = NDArray[np.float64]
_WITNESSES = 80  # scans all over a unit that must bear out where it was found
_SUPPORT = 8  # of them that must agree, at least
_MAJORITY = 3.0  # times more that must agree than contradict
_CONTRADICTS = 0.5  # agreement below which a scan speaks against a place
_STAYS = 0.5  # m that a witness may be moved by its match
_ATTEMPTS = 5  # places that are found and not borne out, before a unit is given up


def find_joints(session_maps: list[SessionMap], config: Config, progress: Progress) -> list[Joint]:
    """For each unit one earlier unit of every group that it belongs to."""
    group = list(range(len(session_maps)))
    joints: list[Joint] = []
    places: dict[int, KnownPlace] = {}
    progress.stage("join sessions", len(session_maps), "sessions")
    for later in range(1, len(session_maps)):
        for earlier in range(later):
            if group[earlier] == group[later]:
                continue
            joint = _join(session_maps, earlier, later, places, config)
            if joint is not None:
                joints.append(joint)
                old, new = group[later], group[earlier]
                group = [new if g == old else g for g in group]
        progress.update(later + 1)
    return joints


def _join(
    session_maps: list[SessionMap],
    earlier: int,
    later: int,
    places: dict[int, KnownPlace],
    config: Config,
) -> Joint | None:
    a, b = session_maps[earlier], session_maps[later]
    if not have_scans(a, b):
        return by_images.locate_session_map(a, b, earlier, later, config)
    if earlier not in places:
        places.clear()  # a place is large, and mostly the first one serves
        places[earlier] = known_place_from_store(a.store, config)
    return locate_session_map(b, places[earlier], earlier, later, config)


def have_scans(a: SessionMap, b: SessionMap) -> bool:
    """Whether a laser drew both."""
    return a.planar and b.planar and has_scans(a.store) and has_scans(b.store)


def locate_session_map(
    session_map: SessionMap, place: KnownPlace, earlier: int, later: int, config: Config
) -> Joint | None:
    """Follows the unit's path through the place until it is recognised and borne out."""
    seeker, attempts, begun = GlobalLocalisation(place, config), 0, False
    for moment, pose in _moments(session_map, config):
        if not begun:
            seeker.begin_anywhere(moment)
            begun = True
            continue
        found = seeker.look(moment)
        if found is None:
            continue
        joint = compose_planar(found.match.pose, invert_planar(pose))
        support, against = _testify(session_map, place, joint, config)
        decided("join", f"session at {joint.round(2)}: {support} scans agree, {against} contradict")
        if support >= _SUPPORT and support >= _MAJORITY * against:
            return Joint(earlier, later, planar_to_matrix(joint))
        attempts += 1
        if attempts == _ATTEMPTS:
            return None
        seeker.begin_anywhere(moment)
    return None


def _moments(session_map: SessionMap, config: Config) -> Iterator[tuple[Moment, Array]]:
    """The nodes' scans in the order of the drive, with the motion between them."""
    before: Array | None = None
    for row, scan in _node_scans(session_map, np.arange(len(session_map.nodes))):
        pose = session_map.poses[row]
        step = np.zeros(3) if before is None else between_planar(before, pose)
        before = pose
        yield _moment(row, scan, pose, step, config), pose


def _node_scans(session_map: SessionMap, rows: NDArray[np.int64]) -> Iterator[tuple[int, Scan]]:
    frames = session_map.store.tracked_frames()
    at = np.flatnonzero(frames.is_node)
    row_of = {node.id: row for row, node in enumerate(session_map.nodes)}
    wanted = set(rows.tolist())
    row_at = {int(f): row_of[int(frames.node_ids[f])] for f in at}
    chosen = np.array([f for f, row in row_at.items() if row in wanted], np.int64)
    for frame, scan in session_map.store.scans(chosen):
        yield row_at[frame], scan


def _moment(row: int, scan: Scan, pose: Array, step: Array, config: Config) -> Moment:
    prepared = prepare_scan(scan, config.registration)
    points = thinned_points(prepared, config.localisation.field_points)
    return Moment(row, prepared, points, pose, step, False, False)


def _testify(
    session_map: SessionMap, place: KnownPlace, joint: Array, config: Config
) -> tuple[int, int]:
    """How many scans all over the unit agree that it lies so, and how many contradict."""
    count = len(session_map.nodes)
    rows = np.unique(np.linspace(0, count - 1, min(_WITNESSES, count)).astype(np.int64))
    support = against = 0
    for row, scan in _node_scans(session_map, rows):
        guess = compose_planar(joint, session_map.poses[row])
        fit = _witness(
            place, _moment(row, scan, session_map.poses[row], np.zeros(3), config), guess, config
        )
        support += fit is not None and is_convincing(fit, config)
        against += fit is not None and fit.agreement < _CONTRADICTS
    return support, against


def _witness(place: KnownPlace, moment: Moment, guess: Array, config: Config) -> Fit | None:
    if moment.is_blind:
        return None
    match = match_at(place, moment, guess, COARSE, config)
    apart = float(np.hypot(*between_planar(guess, match.pose)[:2]))
    return fit_at(place, moment, guess if apart > _STAYS else match.pose, config)
