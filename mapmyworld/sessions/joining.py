"""Which sessions show the same place, by laser or by images, how they lie, and closures."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import replace

import numpy as np

from mapmyworld.config import Config
from mapmyworld.geometry import Array
from mapmyworld.geometry.planar import planar_to_matrix
from mapmyworld.geometry.rigid import between, invert
from mapmyworld.geometry.rotations import rotation_angle
from mapmyworld.localisation.known_images import KnownImages
from mapmyworld.places.laser_nodes import load_node_scans, nodes_at
from mapmyworld.places.session_closures import closures_between
from mapmyworld.places.session_joining import find_joints, locate_session
from mapmyworld.places.session_places import SessionPlaces
from mapmyworld.registration.views import View
from mapmyworld.sessions.copying import Placed
from mapmyworld.sessions.session_maps import SessionMap
from mapmyworld.stages.kept import has_scans
from mapmyworld.stages.recognise import LoadScans
from mapmyworld.types import Judged, Poses, Progress

_WITNESSES = 80  # images all over a session map that are looked for in the earlier one
_SUPPORT = 6  # sightings that must report one joint, at least
_MAJORITY = 3.0  # times more that must agree than contradict
_AGREES = (0.4, 0.15)  # m and rad within which a sighting bears a joint out


def _located_by_images(a: SessionMap, b: SessionMap, config: Config) -> Array | None:
    """(4, 4) where most sightings of `a` by `b` put `b`, if they agree and are many."""
    images = KnownImages(a.store, config)
    if len(images) == 0 or a.planar != b.planar:
        return None
    found = [
        (row, sighting.map_from_base)
        for row, view in _views(b, images)
        if (sighting := images.most_alike(view)) is not None
    ]
    if len(found) < _SUPPORT:
        return None
    own = b.solved[[row for row, _ in found]]
    seen = np.stack([pose for _, pose in found])
    joints = seen @ invert(own)
    support = np.array([_agreeing(joint, own, seen) for joint in joints])
    best = int(np.argmax(support))
    agree, against = int(support[best]), len(found) - int(support[best])
    if agree < _SUPPORT or agree < _MAJORITY * against:
        return None
    return np.asarray(joints[best])


def _views(session_map: SessionMap, images: KnownImages) -> Iterator[tuple[int, View]]:
    """Views of some of a session map's nodes in the other's words; no image is decoded."""
    count = len(session_map.nodes)
    rows = np.unique(np.linspace(0, count - 1, min(_WITNESSES, count)).astype(np.int64))
    for row in rows.tolist():
        data = session_map.store.node_data(session_map.nodes[row].id)
        if data.features is None or not data.images:
            continue
        view = images.view_of_features(data.features, data.images[0].camera)
        if view is not None:
            yield row, view


def _agreeing(joint: Array, own: Array, seen: Array) -> int:
    """How many sightings (K, 4, 4) of `own` poses a joint explains."""
    off = between(joint @ own, seen)
    near = np.linalg.norm(off[:, :3, 3], axis=1) < _AGREES[0]
    return int(np.count_nonzero(near & (rotation_angle(off) < _AGREES[1])))


def join_session_maps(
    session_maps: list[SessionMap], config: Config, progress: Progress
) -> dict[tuple[int, int], Array]:
    """The later frame (4, 4) in the earlier one, of the pairs that `find_joints` finds."""
    maps = [
        session_places(session_map, config) if has_laser(session_map) else None
        for session_map in session_maps
    ]
    progress.stage("join sessions", len(session_maps), "sessions")

    def locate(earlier: int, later: int) -> Array | None:
        progress.update(later)
        a, b = maps[earlier], maps[later]
        if a is None or b is None:
            return _located_by_images(session_maps[earlier], session_maps[later], config)
        move = locate_session(a, b)
        return None if move is None else planar_to_matrix(move)

    return find_joints(len(session_maps), locate)


def has_laser(session_map: SessionMap) -> bool:
    """Whether a laser drew it."""
    return session_map.planar and has_scans(session_map.store)


def session_places(session_map: SessionMap, config: Config) -> SessionPlaces:
    """What a session's laser saw, at its final poses."""
    store = session_map.store
    nodes = nodes_at(load_node_scans(store, config), store.poses(), None, store.constraints())
    return SessionPlaces(nodes, np.arange(len(nodes.ids)), config)


def tie_sessions(
    placed: Sequence[Placed], joined: Iterable[tuple[int, int]], scans: LoadScans, config: Config
) -> list[Judged]:
    """Closures by laser for every (earlier, later) of these, from where they were found to lie.

    The maps are as they were when they were finished, which no graph without their aligned scans
    gives again.
    """
    loaded = scans()
    if loaded is None:
        return []
    ids = np.array([p.new_id(node.id) for p in placed for node in p.session_map.nodes], np.int64)
    solved = np.concatenate([p.common_from_session_map @ p.session_map.solved for p in placed])
    number = np.repeat(np.arange(len(placed)), [len(p.session_map.nodes) for p in placed])
    stated = [
        replace(c, from_id=p.new_id(c.from_id), to_id=p.new_id(c.to_id))
        for p in placed
        for c in p.session_map.store.constraints()
    ]
    nodes = nodes_at(loaded, Poses(ids, solved), None, stated)
    nodes = replace(nodes, session=number[np.searchsorted(ids, nodes.ids)])
    maps = [
        SessionPlaces(nodes, np.flatnonzero(nodes.session == k), config) for k in range(len(placed))
    ]
    return [
        c
        for earlier, later in joined
        for c in closures_between(nodes, maps[earlier], maps[later], config)
    ]
