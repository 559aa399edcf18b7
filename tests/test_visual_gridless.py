"""A camera whose depth shows nothing: the map does without a grid."""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np
from memory_store import MemoryStore
from visual_rooms import HEIGHT, WIDTH, Room, planar_pose

from mapmyworld.config import Config
from mapmyworld.stages.draw_maps import draw_maps
from mapmyworld.types import ImageMessage, Node, NodeData, Poses, RgbdImage

POSE = planar_pose(3.0, 2.5, 0.0)


@dataclass
class Heard:
    """Progress that remembers what it was reported."""

    notes: list[str] = field(default_factory=list)

    def stage(self, name: str, total: float | None = None, unit: str = "") -> None: ...

    def update(self, done: float) -> None: ...

    def note(self, message: str) -> None:
        self.notes.append(message)


def drawn(image: RgbdImage) -> tuple[MemoryStore, Heard]:
    """What a map of one node with that image becomes."""
    store, heard = MemoryStore(), Heard()
    store.add_node(Node(1, 0, 0, POSE, POSE), NodeData(images=(image,)))
    store.set_poses(Poses(np.array([1]), POSE[None]))
    draw_maps(store, Config(threads=1), heard)
    return store, heard


def test_depth_that_shows_walls_becomes_a_grid() -> None:
    store, heard = drawn(Room().image(POSE, height=0.4))
    assert store.grid() is not None
    assert heard.notes == []


def test_depth_that_shows_nothing_becomes_a_note() -> None:
    empty = np.zeros((HEIGHT, WIDTH), np.float32)
    deep = ImageMessage(0, "camera", "32FC1", WIDTH, HEIGHT, lambda: empty)
    store, heard = drawn(replace(Room().image(POSE), depth=deep))
    assert store.grid() is None
    assert len(heard.notes) == 1
    assert heard.notes[0].startswith("no grid from depth: ")
