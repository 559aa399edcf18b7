"""Features of nodes' images, found on a thread of their own while the log is still tracked."""

from __future__ import annotations

from collections.abc import Callable
from concurrent.futures import Future
from functools import partial
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from mapmyworld.config import Config
from mapmyworld.geometry.rigid import between
from mapmyworld.geometry.rotations import rotation_angle
from mapmyworld.parallel import Aside
from mapmyworld.types import MapStore, Node, NodeData, RgbdImage

if TYPE_CHECKING:
    from mapmyworld.places.node_features import Prepared

_TOGETHER = 8  # nodes that are read from the store at once: what waits there is written first
_MOST_WAITING = 32  # nodes whose images wait in memory; others are looked at later


class FeaturesAhead:
    """What `NodeImages` would find of the nodes it will ask for, as far as time allowed.

    Which nodes these are is a guess, and what is missing is found when it is needed: so the result
    is the same with and without.
    """

    def __init__(self, config: Config) -> None:
        self._config = config
        self._aside = Aside()
        self._found: dict[int, Future[list[Prepared]]] = {}
        self._due: list[int] = []
        self._last: NDArray[np.float64] | None = None
        self._path = self._marks = 0.0

    def __len__(self) -> int:
        """Nodes whose features were found, or soon will be."""
        return len(self._found)

    def note(self, store: MapStore, node: Node, data: NodeData) -> None:
        """A node that the store holds by now."""
        room = self._config.visual.place_nodes - len(self._found) - len(self._due)
        if self._is_compared(node, data) and room > 0:
            self._due.append(node.id)
        if len(self._due) == _TOGETHER:
            self._begin(store)

    def take(self, node_id: int) -> list[Callable[[], Prepared]] | None:
        """What gives the features of each image of a node, once; None where nothing was found."""
        found = self._found.pop(node_id, None)
        if found is None or found.cancel():
            return None
        return [partial(_itself, prepared) for prepared in found.result()]

    def _is_compared(self, node: Node, data: NodeData) -> bool:
        """As `evenly_along` chooses where a laser tracks; all nodes otherwise."""
        spacing = self._config.visual.place_spacing
        if spacing <= 0.0 or data.scan is None:
            return True
        if self._last is not None:
            step = between(self._last, node.tracked_from_base)
            self._path += max(float(np.linalg.norm(step[:3, 3])), float(rotation_angle(step)))
        self._last = node.tracked_from_base
        before, self._marks = self._marks, np.floor(self._path / spacing + 1e-9) + 1.0
        return bool(self._marks > before)

    def _begin(self, store: MapStore) -> None:
        """Images are read as they were kept, which is how they will be read again.

        They are read even where nobody has time for them: reading makes the store write what
        waits, and its bytes shall not depend on time.
        """
        from mapmyworld.places.node_features import usable_images

        due, self._due = self._due, []
        waiting = sum(not found.done() for found in self._found.values())
        for node_id in due:
            images = usable_images(store.node_data(node_id, features=False))
            if waiting < _MOST_WAITING:
                self._found[node_id] = self._aside.begin(self._prepared, images)

    def _prepared(self, images: list[RgbdImage]) -> list[Prepared]:
        import cv2

        from mapmyworld.places.node_features import prepared_image

        cv2.setNumThreads(1)
        return [prepared_image(image, None, self._config) for image in images]


def _itself(prepared: Prepared) -> Prepared:
    return prepared
