"""Two nodes of a map, their images compared once more, for people who want to see why."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mapmyworld.config import Config
from mapmyworld.errors import MapError
from mapmyworld.places.camera_features import features_of_camera
from mapmyworld.places.features import extract_features
from mapmyworld.registration.image_pairs import ImagePair, register_images
from mapmyworld.registration.views import View, make_view
from mapmyworld.types import Features, MapStore


@dataclass(frozen=True, slots=True, eq=False)
class NodePair:
    """What `formats.report.match_picture` needs of two nodes."""

    pair: ImagePair
    features_a: Features
    features_b: Features
    picture_a: NDArray[np.uint8]
    """(H, W, 3) RGB or (H, W)."""
    picture_b: NDArray[np.uint8]


def compare_nodes(store: MapStore, a: int, b: int, config: Config) -> NodePair:
    """The images of nodes `a` and `b`, matched as for a loop closure.

    Raises `MapError` where a node does not exist or has no image.
    """
    (view_a, picture_a), (view_b, picture_b) = (_seen(store, n, config) for n in (a, b))
    pair = register_images(view_a, view_b, config)
    return NodePair(pair, view_a.features, view_b.features, picture_a, picture_b)


def _seen(store: MapStore, node_id: int, config: Config) -> tuple[View, NDArray[np.uint8]]:
    if all(node.id != node_id for node in store.nodes()):
        raise MapError(f"there is no node {node_id} in this map")
    data = store.node_data(node_id)
    for number, image in enumerate(data.images):
        if image.colour is not None:
            kept = data.features
            own = kept and features_of_camera(kept, number, image.camera.width)
            features = own or extract_features(image, config)
            picture = np.asarray(image.colour.pixels(), np.uint8)
            return make_view(features, image.camera, config), picture
    raise MapError(f"node {node_id} has no image: only nodes seen by a camera can be compared")
