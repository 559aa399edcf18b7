"""Two nodes of a map, their images compared once more, for people who want to see why."""

from __future__ import annotations

import functools
from collections.abc import Container, Iterable, Iterator
from dataclasses import dataclass

from mapmyworld.config import Config
from mapmyworld.errors import MapError, MapMyWorldError
from mapmyworld.parallel import in_threads
from mapmyworld.places.node_features import features_of_camera
from mapmyworld.registration.features import extract_features
from mapmyworld.registration.image_pairs import ImagePair, register_images
from mapmyworld.registration.views import View, make_view
from mapmyworld.types import Features, ImageMessage, MapStore, RgbdImage


@dataclass(frozen=True, slots=True, eq=False)
class NodePair:
    """What `formats.report.match_picture` needs of two nodes."""

    pair: ImagePair
    features_a: Features
    features_b: Features
    colour_a: ImageMessage
    colour_b: ImageMessage


@dataclass(frozen=True, slots=True, eq=False)
class _Seen:
    """A node's first image, and its features where the map keeps them."""

    image: RgbdImage
    kept: Features | None


def compare_nodes(store: MapStore, a: int, b: int, config: Config) -> NodePair:
    """The images of nodes `a` and `b`, matched as for a loop closure.

    Raises `MapError` where a node does not exist or has no image.
    """
    return _compared(_seen(store, a), _seen(store, b), config)


def compare_pairs(
    store: MapStore, pairs: Iterable[tuple[int, int]], config: Config
) -> Iterator[NodePair | None]:
    """`compare_nodes` of many pairs in turn, on all cores; None where one cannot be compared."""
    known = {node.id for node in store.nodes()}

    @functools.lru_cache
    def seen(node_id: int) -> _Seen:
        return _seen(store, node_id, known)

    def asked() -> Iterator[tuple[_Seen, _Seen] | None]:
        for a, b in pairs:
            try:
                yield seen(a), seen(b)
            except MapMyWorldError:
                yield None

    def compare(item: tuple[_Seen, _Seen] | None) -> NodePair | None:
        try:
            return None if item is None else _compared(*item, config)
        except MapMyWorldError:
            return None

    yield from in_threads(compare, asked(), config.threads)


def _compared(a: _Seen, b: _Seen, config: Config) -> NodePair:
    view_a, view_b = _view(a, config), _view(b, config)
    assert a.image.colour is not None
    assert b.image.colour is not None
    pair = register_images(view_a, view_b, config)
    return NodePair(pair, view_a.features, view_b.features, a.image.colour, b.image.colour)


def _view(seen: _Seen, config: Config) -> View:
    features = seen.kept or extract_features(seen.image, config)
    return make_view(features, seen.image.camera, config)


def _seen(store: MapStore, node_id: int, known: Container[int] | None = None) -> _Seen:
    if node_id not in ({node.id for node in store.nodes()} if known is None else known):
        raise MapError(f"there is no node {node_id} in this map")
    data = store.node_data(node_id)
    for number, image in enumerate(data.images):
        if image.colour is not None:
            kept = data.features
            return _Seen(image, kept and features_of_camera(kept, number, image.camera.width))
    raise MapError(f"node {node_id} has no image: only nodes seen by a camera can be compared")
