"""What a camera can be compared with: the images of a finished map's nodes, by their words."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np

from mapmyworld.config import Config
from mapmyworld.geometry import Array
from mapmyworld.geometry.rigid import between
from mapmyworld.geometry.rotations import rotation_angle
from mapmyworld.places.appearance import distinct, inverse_frequencies, weigh_words
from mapmyworld.places.image_proposals import CANDIDATES, NEAR, NEAR_ANGLE
from mapmyworld.places.node_features import best_features, features_of_camera
from mapmyworld.places.vocabulary import Vocabulary
from mapmyworld.registration.features import extract_features
from mapmyworld.registration.image_pairs import register_images
from mapmyworld.registration.scan_search import APART
from mapmyworld.registration.views import View, binary_words, make_view
from mapmyworld.types import CameraModel, Features, MapStore, Registration, RgbdImage


@dataclass(frozen=True, slots=True, eq=False)
class Sighting:
    """A node of the map recognised in an image."""

    map_from_base: Array
    """(4, 4)."""
    registration: Registration


class KnownImages:
    """The nodes that keep features, where they are, and their words."""

    def __init__(self, store: MapStore, config: Config) -> None:
        """Reads the words of all nodes; images are not decoded."""
        self._store, self._config = store, config
        self._view = lru_cache(self._read_view)
        self._vocabulary = Vocabulary.of(store.words())
        poses, kept, ids, solved = store.poses(), [], [], []
        size = self._vocabulary.size
        if poses is not None and size:
            for node_id, pose in zip(poses.ids.tolist(), poses.map_from_node, strict=True):
                features = store.node_data(node_id).features if node_id > 0 else None
                if features is not None and features.words is not None:
                    kept.append(np.where(features.words <= size, features.words, 0))
                    ids.append(node_id)
                    solved.append(pose)
        self.ids = np.array(ids, np.int64)
        self.map_from_node = np.array(solved).reshape(-1, 4, 4)
        self._idf = inverse_frequencies(kept, size)
        self._vectors = weigh_words(kept, size)

    def __len__(self) -> int:
        return len(self.ids)

    def view_of(self, image: RgbdImage) -> View | None:
        """An image's features with words; None where it lacks colour or depth."""
        if image.colour is None or image.depth is None:
            return None
        return self.view_of_features(extract_features(image, self._config), image.camera)

    def view_of_features(self, features: Features, camera: CameraModel) -> View | None:
        """The same of features that were found before, in another map's image."""
        best = best_features(features, camera, self._config)
        if len(best.pixels) == 0:
            return None
        words = self._vocabulary.words(binary_words(best))
        return make_view(replace(best, words=words), camera, self._config)

    def _similar(self, view: View) -> list[int]:
        """Nodes whose words are most like the view's, best first."""
        words = np.asarray(view.features.words, np.int64)
        weights = np.bincount(words[words > 0], minlength=len(self._idf))[: len(self._idf)]
        vector = weights * self._idf
        length = float(np.linalg.norm(vector))
        if length == 0.0:
            return []
        likeness = np.asarray(self._vectors @ vector).ravel() / length
        order = np.argsort(-likeness, kind="stable")
        alike = likeness[order] >= self._config.visual.place_similarity
        return distinct(order[alike], CANDIDATES)

    def most_alike(self, view: View) -> Sighting | None:
        """The one place that the view fits; None where it fits several, or none."""
        found = [self.sight(view, node) for node in self._similar(view)]
        seen = [sighting for sighting in found if sighting is not None]
        if not seen:
            return None
        best = max(seen, key=lambda sighting: sighting.registration.inliers)
        for other in seen:
            apart = best.map_from_base[:3, 3] - other.map_from_base[:3, 3]
            if float(np.linalg.norm(apart)) > APART[0]:
                return None
        return best

    def near(self, map_from_base: Array) -> list[int]:
        """Nodes that look the same way from close to `map_from_base` (4, 4), nearest first."""
        motion = between(map_from_base, self.map_from_node)
        apart = np.linalg.norm(motion[:, :3, 3], axis=1)
        turn = rotation_angle(motion)
        close = np.flatnonzero((apart < NEAR) & (turn < np.radians(NEAR_ANGLE)))
        order = close[np.argsort(apart[close] + turn[close], kind="stable")]
        return [int(k) for k in order[:CANDIDATES]]

    def sight(self, view: View, node: int, guess: Array | None = None) -> Sighting | None:
        """The pose that a node's image gives a view; `guess` (4, 4) is of map_from_base."""
        known = self._view(node)
        if known is None:
            return None
        node_guess = None if guess is None else between(self.map_from_node[node], guess)
        found = register_images(known, view, self._config, guess=node_guess).registration
        if not found.verdict.accepted:
            return None
        return Sighting(self.map_from_node[node] @ found.a_from_b, found)

    def _read_view(self, node: int) -> View | None:
        data = self._store.node_data(int(self.ids[node]))
        image = next((i for i in data.images if i.colour and i.depth), None)
        if image is None or data.features is None:
            return None
        own = features_of_camera(data.features, data.images.index(image), image.camera.width)
        features = best_features(own, image.camera, self._config)
        return make_view(features, image.camera, self._config)
