"""The nodes' images as features and words, prepared on several threads, in the nodes' order."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import replace
from functools import partial

import cv2
import numpy as np
from numpy.typing import NDArray

from mapmyworld.config import Config
from mapmyworld.geometry.rigid import evenly_along
from mapmyworld.parallel import in_threads
from mapmyworld.places.node_features import (
    Prepared,
    features_of_camera,
    joined_features,
    prepared_image,
    usable_images,
)
from mapmyworld.places.vocabulary import Vocabulary
from mapmyworld.registration.views import View, binary_words, make_view
from mapmyworld.types import (
    CameraModel,
    Features,
    MapStore,
    Node,
    NodeData,
    Progress,
    first_nodes,
)

_MOST_NODES = 3000  # compared with each other, evenly chosen from longer logs
_SPACING = 0.5  # m or rad between nodes whose images are compared, with a laser
_TRAINING = 60_000  # descriptors that the vocabulary is learned from, at most


class NodeImages:
    """Features and words of the nodes' images, found once and then kept in the store.

    An image is a row: first camera 0 of all nodes, then camera 1, and so on, each in time.
    """

    def __init__(self, store: MapStore, config: Config, progress: Progress) -> None:
        """Reads features from the store where an earlier round left them, as they are asked for."""
        self._store, self._config = store, config
        self._features: list[Features] = []
        nodes = _compared(store)
        every = max(1, -(-len(nodes) // _MOST_NODES))
        self.nodes: list[Node] = list(nodes[::every])
        self.have_words = bool(store.words())
        if self.have_words:
            looked_at = first_nodes(self.nodes)
            cameras = max((len(usable_images(self._data(n, False))) for n in looked_at), default=0)
            self._set_rows([(k, n) for k in range(cameras) for n in range(len(self.nodes))])
        else:
            self._extract(progress)

    def __len__(self) -> int:
        return len(self.nodes)

    def _set_rows(self, rows: list[tuple[int, int]]) -> None:
        numbers = np.array(rows, np.int64).reshape(-1, 2)
        self.camera_of, self.node_of = numbers[:, 0], numbers[:, 1]

    def _data(self, node: Node, features: bool = True) -> NodeData:
        return self._store.node_data(node.id, features=features)

    def _extract(self, progress: Progress) -> None:
        """Features of all nodes; those without an image are left out from then on."""
        progress.stage("features", len(self.nodes), "nodes")
        cv2.setNumThreads(1)
        found: list[tuple[int, int, Features, CameraModel]] = []
        images = in_threads(lambda i: (i[0], i[1], i[2]()), self._images(), self._config.threads)
        for k, n, prepared in images:
            progress.update(n)
            found.append((k, n, *prepared))
        found.sort(key=lambda row: row[:2])
        seen = sorted({n for _, n, _, _ in found})
        place = {n: index for index, n in enumerate(seen)}
        self._set_rows([(k, place[n]) for k, n, _, _ in found])
        self.nodes = [self.nodes[n] for n in seen]
        self._features = [features for _, _, features, _ in found]
        self._cameras = [camera for _, _, _, camera in found]

    def _images(self) -> Iterator[tuple[int, int, Callable[[], Prepared]]]:
        """Camera, node, and what gives its features: left to other threads."""
        for n, node in enumerate(self.nodes):
            for k, make in enumerate(self._makers(node)):
                yield k, n, make

    def _makers(self, node: Node) -> Iterator[Callable[[], Prepared]]:
        """One for each usable image of a node; features that the store has are not found again."""
        data = self._data(node)
        for k, image in enumerate(usable_images(data)):
            known = data.features and features_of_camera(data.features, k, image.camera.width)
            yield partial(prepared_image, image, known, self._config)

    def stamps(self) -> NDArray[np.int64]:
        """(R,) of each row, nanoseconds."""
        return np.array([node.stamp_ns for node in self.nodes], np.int64)[self.node_of]

    def sessions(self) -> NDArray[np.int64]:
        """(R,) of each row."""
        return np.array([node.session for node in self.nodes], np.int64)[self.node_of]

    def view(self, row: int) -> View | None:
        """The view of a row, which for camera 0 is the number of its node; None without image."""
        if self._features:
            return make_view(self._features[row], self._cameras[row], self._config)
        k, node = int(self.camera_of[row]), self.nodes[self.node_of[row]]
        makers = list(self._makers(node))
        return make_view(*makers[k](), self._config) if k < len(makers) else None

    def learn_words(self, given: Mapping[int, NDArray[np.uint8]] | None = None) -> Vocabulary:
        """A vocabulary of these images, or the given one; their features then carry its words.

        `given`: word id -> descriptor (D,).
        """
        vocabulary = Vocabulary.of(given) if given else self._learned()
        self._features = [
            replace(f, words=vocabulary.words(binary_words(f))) for f in self._features
        ]
        return vocabulary

    def _learned(self) -> Vocabulary:
        per_image = max(1, _TRAINING // max(len(self._features), 1))
        sample = [_sample(f, per_image) for f in self._features]
        return Vocabulary.learned(np.concatenate(sample), self._config.seed)

    def words(self) -> list[NDArray[np.int32]]:
        """The words (N,) of each image."""
        return [np.asarray(f.words, np.int32) for f in self._features]

    def keep(self, store: MapStore, vocabulary: Vocabulary) -> None:
        """Writes features and vocabulary to the store."""
        store.set_words(vocabulary.word_descriptors())
        rows_of: list[list[int]] = [[] for _ in self.nodes]
        for row, n in enumerate(self.node_of.tolist()):
            rows_of[n].append(row)
        for node, rows in zip(self.nodes, rows_of, strict=True):
            parts = [self._features[row] for row in rows]
            store.set_features(node.id, joined_features(parts, self._cameras[rows[0]].width))


def _compared(store: MapStore) -> list[Node]:
    """The nodes whose images are compared: where a laser tracks, some, since it drifts little."""
    nodes = list(store.nodes())
    if not nodes or store.node_data(nodes[0].id).scan is None:
        return nodes
    sessions = np.array([node.session for node in nodes])
    poses = np.stack([node.tracked_from_base for node in nodes])
    chosen: list[int] = []
    for session in dict.fromkeys(sessions.tolist()):
        own = np.flatnonzero(sessions == session)
        chosen += own[evenly_along(poses[own], _SPACING)].tolist()
    return [nodes[k] for k in sorted(chosen)]


def _sample(features: Features, count: int) -> NDArray[np.uint64]:
    """The strongest descriptors (N, 4) of an image."""
    order = np.argsort(-features.responses, kind="stable")[:count]
    return binary_words(features)[np.sort(order)]
