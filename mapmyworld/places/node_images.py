"""The nodes' images as features and words, prepared on several threads, in the nodes' order."""

from __future__ import annotations

from dataclasses import replace

import cv2
import numpy as np
from numpy.typing import NDArray

from mapmyworld.config import Config
from mapmyworld.parallel import in_threads
from mapmyworld.places.features import extract_features, spread
from mapmyworld.places.vocabulary import Vocabulary, train_vocabulary
from mapmyworld.registration.views import View, binary_words, make_view
from mapmyworld.types import CameraModel, Features, MapStore, Node, NodeData, Progress

_TRAINING = 60_000  # descriptors that the vocabulary is learned from, at most


class NodeImages:
    """Features and words of every node with an image; views are made when asked for."""

    def __init__(self, store: MapStore, config: Config, progress: Progress) -> None:
        self._config = config
        nodes = store.nodes()
        every = max(1, -(-len(nodes) // config.visual.place_nodes))
        self.nodes: list[Node] = []
        self._features: list[Features] = []
        self._cameras: list[CameraModel] = []
        self._views: dict[int, View] = {}
        progress.stage("features", len(nodes), "nodes")
        cv2.setNumThreads(1)
        chosen = nodes[::every]
        data = (store.node_data(node.id) for node in chosen)
        done = in_threads(self._prepare, data, config.threads)
        for node, found in zip(chosen, done, strict=True):
            progress.update(node.id)
            if found is not None:
                self.nodes.append(node)
                self._features.append(found[0])
                self._cameras.append(found[1])

    def __len__(self) -> int:
        return len(self.nodes)

    @property
    def have_words(self) -> bool:
        """Whether all features came from the store with their words."""
        return all(f.words is not None and f.words.any() for f in self._features)

    def view(self, index: int) -> View:
        """The view of the node at `index` of `nodes`."""
        view = self._views.get(index)
        if view is None:
            view = make_view(self._features[index], self._cameras[index], self._config)
            if len(self._views) > 600:
                self._views.clear()
            self._views[index] = view
        return view

    def learn_words(self) -> Vocabulary:
        """A vocabulary of these images; their features then carry its words."""
        per_image = max(1, _TRAINING // max(len(self._features), 1))
        sample = [_sample(f, per_image) for f in self._features]
        vocabulary = train_vocabulary(
            np.concatenate(sample),
            branches=self._config.visual.vocabulary_branches,
            depth=self._config.visual.vocabulary_depth,
            seed=self._config.seed,
        )
        self._features = [
            replace(f, words=vocabulary.words(binary_words(f))) for f in self._features
        ]
        return vocabulary

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
                return _best(features, image.camera, self._config), image.camera
        return None


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


def _best(features: Features, camera: CameraModel, config: Config) -> Features:
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
