"""The nodes' images as features and words, prepared on several threads, in the nodes' order."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import cv2
import numpy as np
from numpy.typing import NDArray

from mapmyworld.config import Config
from mapmyworld.geometry import between, rotation_angle
from mapmyworld.parallel import in_threads
from mapmyworld.places.features import extract_features, spread
from mapmyworld.places.vocabulary import Vocabulary, train_vocabulary, vocabulary_of_words
from mapmyworld.registration.views import View, binary_words, make_view
from mapmyworld.types import CameraModel, Features, MapStore, Node, NodeData, Progress, Scan

_REMEMBERED = 600  # views kept at hand
_TRAINING = 60_000  # descriptors that the vocabulary is learned from, at most


class NodeImages:
    """Features and words of the nodes' images, found once and then kept in the store."""

    def __init__(self, store: MapStore, config: Config, progress: Progress) -> None:
        """Reads features from the store where an earlier round left them, as they are asked for."""
        self._store, self._config = store, config
        self._views: dict[int, View | None] = {}
        self._features: list[Features] = []
        nodes = _compared(store, config)
        every = max(1, -(-len(nodes) // config.visual.place_nodes))
        self.nodes: list[Node] = list(nodes[::every])
        self.have_words = bool(store.words())
        if not self.have_words:
            self._extract(progress)

    def __len__(self) -> int:
        return len(self.nodes)

    def _extract(self, progress: Progress) -> None:
        """Features of all nodes; those without an image are left out from then on."""
        progress.stage("features", len(self.nodes), "nodes")
        cv2.setNumThreads(1)
        data = (self._store.node_data(node.id) for node in self.nodes)
        with_images: list[Node] = []
        self._cameras: list[CameraModel] = []
        found = in_threads(self._prepare, data, self._config.threads)
        for done, (node, item) in enumerate(zip(self.nodes, found, strict=True)):
            progress.update(done)
            if item is not None:
                with_images.append(node)
                self._features.append(item[0])
                self._cameras.append(item[1])
        self.nodes = with_images

    def view(self, index: int) -> View | None:
        """The view of the node at `index` of `nodes`; None without an image."""
        if index not in self._views:
            if len(self._views) > _REMEMBERED:
                self._views.clear()
            self._views[index] = self._load(index)
        return self._views[index]

    def scan(self, index: int) -> Scan | None:
        """The laser scan of the node at `index` of `nodes`."""
        return self._store.node_data(self.nodes[index].id, features=False).scan

    def _load(self, index: int) -> View | None:
        if self._features:
            return make_view(self._features[index], self._cameras[index], self._config)
        item = self._prepare(self._store.node_data(self.nodes[index].id))
        return None if item is None else make_view(*item, self._config)

    def learn_words(self, given: Mapping[int, NDArray[np.uint8]] | None = None) -> Vocabulary:
        """A vocabulary of these images, or the given one; their features then carry its words."""
        seed = self._config.seed
        vocabulary = vocabulary_of_words(given, seed=seed) if given else self._learned()
        self._features = [
            replace(f, words=vocabulary.words(binary_words(f))) for f in self._features
        ]
        return vocabulary

    def _learned(self) -> Vocabulary:
        per_image = max(1, _TRAINING // max(len(self._features), 1))
        sample = [_sample(f, per_image) for f in self._features]
        return train_vocabulary(
            np.concatenate(sample),
            branches=self._config.visual.vocabulary_branches,
            depth=self._config.visual.vocabulary_depth,
            seed=self._config.seed,
        )

    def words(self) -> list[NDArray[np.int32]]:
        """The words (N,) of each image."""
        return [np.asarray(f.words, np.int32) for f in self._features]

    def keep(self, store: MapStore, vocabulary: Vocabulary) -> None:
        """Writes features and vocabulary to the store."""
        store.set_words(vocabulary.word_descriptors())
        for node, features in zip(self.nodes, self._features, strict=True):
            store.set_features(node.id, features)

    def _prepare(self, data: NodeData) -> tuple[Features, CameraModel] | None:
        for image in data.images:
            if image.colour is not None and image.depth is not None:
                features = data.features or extract_features(image, self._config)
                return best_features(features, image.camera, self._config), image.camera
        return None


def _compared(store: MapStore, config: Config) -> list[Node]:
    """The nodes whose images are compared: where a laser tracks, some, since it drifts little."""
    nodes = list(store.nodes())
    spacing = config.visual.place_spacing
    if not nodes or spacing <= 0.0 or store.node_data(nodes[0].id).scan is None:
        return nodes
    poses = np.stack([node.tracked_from_base for node in nodes])
    steps = between(poses[:-1], poses[1:])
    moved = np.maximum(np.linalg.norm(steps[:, :3, 3], axis=1), rotation_angle(steps))
    sessions = np.array([node.session for node in nodes])
    moved[np.diff(sessions) != 0] = spacing
    lengths = np.concatenate([[0.0], np.cumsum(moved)]) / spacing + 1e-9
    return [nodes[k] for k in np.flatnonzero(np.diff(np.floor(lengths), prepend=-1.0))]


def select_features(features: Features, chosen: NDArray[np.int64]) -> Features:
    """The chosen features, all parallel arrays alike."""
    return Features(
        features.pixels[chosen],
        features.points[chosen],
        features.descriptors[chosen],
        features.sizes[chosen],
        features.angles[chosen],
        features.responses[chosen],
        features.octaves[chosen],
        None if features.words is None else features.words[chosen],
    )


def best_features(features: Features, camera: CameraModel, config: Config) -> Features:
    """The features that closures use: at most `visual.place_features`, spread over the image."""
    wanted = config.visual.place_features
    if len(features.pixels) <= wanted:
        return features
    chosen = spread(features.pixels, features.responses, camera.width, camera.height, wanted)
    return select_features(features, chosen)


def _sample(features: Features, count: int) -> NDArray[np.uint64]:
    """The strongest descriptors (N, 4) of an image."""
    order = np.argsort(-features.responses, kind="stable")[:count]
    return binary_words(features)[np.sort(order)]
