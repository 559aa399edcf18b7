"""Features found while the log is still tracked are those that would be found afterwards."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import pytest
from hypothesis import given, strategies
from memory_store import MemoryStore
from numpy.typing import NDArray
from visual_rooms import Room, circle

from mapmyworld.config import Config
from mapmyworld.geometry.planar import planar_to_matrix
from mapmyworld.geometry.rigid import evenly_along
from mapmyworld.places.features_ahead import FeaturesAhead
from mapmyworld.places.node_images import NodeImages
from mapmyworld.types import Node, NodeData, Scan

CONFIG = Config(threads=2)
SCAN = Scan(np.zeros((1, 2), np.float32), np.zeros(3), np.zeros(0, np.float32), 10.0, 0.1)


class Silent:
    """Progress that nobody watches."""

    def stage(self, name: str, total: float | None = None, unit: str = "") -> None: ...

    def update(self, done: float) -> None: ...

    def note(self, message: str) -> None: ...


@dataclass
class _Asked:
    """A store that only says which nodes it was asked for."""

    ids: list[int]

    def node_data(self, node_id: int, *, features: bool = True) -> NodeData:
        self.ids.append(node_id)
        return NodeData()


def nodes_at(poses: Sequence[NDArray[np.float64]]) -> list[Node]:
    return [Node(i + 1, 0, i, pose, pose) for i, pose in enumerate(poses)]


@pytest.mark.parametrize("with_laser", [True, False])
def test_closures_find_the_same_features_with_and_without(with_laser: bool) -> None:
    room, truth = Room(), circle((3.0, 2.5), 1.0, 40, 1.0)
    store, ahead = MemoryStore(), FeaturesAhead(CONFIG)
    for node in nodes_at(truth):
        image = room.image(node.odom_from_base, node.stamp_ns)
        data = NodeData(SCAN if with_laser else None, (image,))
        store.add_node(node, data)
        ahead.note(store, node, data)
    assert len(ahead) >= (8 if with_laser else 32)
    early, late = (NodeImages(store, CONFIG, Silent(), found) for found in (ahead, None))
    assert [n.id for n in early.nodes] == [n.id for n in late.nodes]
    assert len(ahead) == 0
    for row in range(len(early)):
        a, b = early.view(row), late.view(row)
        assert a is not None
        assert b is not None
        for name in ("pixels", "points", "descriptors", "responses", "octaves"):
            found, expected = getattr(a.features, name), getattr(b.features, name)
            np.testing.assert_array_equal(found, expected)


steps = strategies.tuples(strategies.floats(-0.6, 0.6), strategies.floats(-0.6, 0.6))


@given(strategies.lists(steps, min_size=8, max_size=60), strategies.floats(0.05, 1.0))
def test_nodes_are_chosen_as_evenly_along_a_path(
    moves: list[tuple[float, float]], spacing: float
) -> None:
    config = replace(CONFIG, visual=replace(CONFIG.visual, place_spacing=spacing))
    places = np.cumsum([(x, 0.0, turn) for x, turn in moves], axis=0)
    poses = planar_to_matrix(places)
    store, ahead = _Asked([]), FeaturesAhead(config)
    for node in nodes_at(list(poses)):
        ahead.note(store, node, NodeData(SCAN))  # type: ignore[arg-type]
    chosen = (evenly_along(poses, spacing) + 1).tolist()
    assert store.ids == chosen[: len(store.ids)]
    assert len(chosen) - len(store.ids) < 8
