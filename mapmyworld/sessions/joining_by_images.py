"""How a session map lies in an earlier one, by what their images show: for maps without a laser."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from mapmyworld.config import Config
from mapmyworld.geometry.rigid import between, invert
from mapmyworld.geometry.rotations import rotation_angle
from mapmyworld.localisation.known_images import KnownImages
from mapmyworld.registration.views import View
from mapmyworld.sessions.session_maps import SessionMap

Array = NDArray[np.float64]
_WITNESSES = 80  # images all over a session map that are looked for in the earlier one
_SUPPORT = 6  # sightings that must report one joint, at least
_MAJORITY = 3.0  # times more that must agree than contradict
_AGREES = (0.4, 0.15)  # m and rad within which a sighting bears a joint out


def locate_session_map(a: SessionMap, b: SessionMap, config: Config) -> Array | None:
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
