"""Several cameras on one robot: features of all of them, kept side by side as RTAB-Map does."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from memory_store import MemoryStore
from numpy.typing import NDArray
from test_visual_places import Silent, drifting, translation_errors
from visual_rooms import WIDTH, Room, planar_pose

from mapmyworld.config import Config
from mapmyworld.places.camera_features import features_of_camera, joined_features
from mapmyworld.places.features import extract_features
from mapmyworld.places.node_images import NodeImages
from mapmyworld.places.visual_closures import find_visual_closures
from mapmyworld.types import Node, NodeData, Poses, RgbdImage

Array = NDArray[np.float64]
CONFIG = Config(threads=2)
TURNED = planar_pose(0.0, 0.0, np.pi)


def backwards(room: Room, pose: Array, stamp: int) -> RgbdImage:
    """What a second camera sees that looks where the robot came from."""
    image = room.image(pose @ TURNED, stamp)
    mount = TURNED @ image.camera.base_from_camera
    return replace(image, camera=replace(image.camera, base_from_camera=mount))


def there_and_back(cameras: int) -> tuple[MemoryStore, list[Array]]:
    """Along a room, then back facing the other way: one camera never sees a place twice."""
    room = Room(size=(7.0, 5.0, 2.5))
    truth = [planar_pose(2.0 + 0.15 * i, 2.4, 0.0) for i in range(18)]
    truth += [planar_pose(4.5 - 0.15 * i, 2.5, np.pi) for i in range(18)]
    store = MemoryStore()
    for i, (pose, tracked) in enumerate(zip(truth, drifting(truth, 0), strict=True)):
        stamp = i * 1_000_000_000
        images = (room.image(pose, stamp), backwards(room, pose, stamp))[:cameras]
        store.add_node(Node(i + 1, 0, stamp, tracked, tracked), NodeData(images=images))
    return store, truth


def test_a_camera_that_looks_back_recognises_what_the_other_one_saw() -> None:
    lonely, _ = there_and_back(1)
    store, truth = there_and_back(2)
    alone, both = (
        [c for c in find_visual_closures(s, None, CONFIG, Silent()) if c.accepted]
        for s in (lonely, store)
    )
    across = [c for c in both if abs(c.from_id - c.to_id) > 6]
    assert not [c for c in alone if abs(c.from_id - c.to_id) > 6]
    assert len(across) >= 8
    assert max(translation_errors(across, truth)) < 0.1
    pairs = [frozenset((c.from_id, c.to_id)) for c in both]
    assert len(set(pairs)) == len(pairs)


def test_solved_poses_bring_images_of_different_cameras_together() -> None:
    """As the optimiser asks it: features come from the store, with words, from both cameras."""
    store, truth = there_and_back(2)
    images = NodeImages(store, CONFIG, Silent())
    images.keep(store, images.learn_words())
    poses = Poses(np.arange(1, len(truth) + 1), np.stack(truth))
    found = find_visual_closures(store, poses, CONFIG, Silent())
    near = [c for c in found if c.accepted and abs(c.from_id - c.to_id) > 6]
    assert near
    assert max(translation_errors(near, truth)) < 0.1


def test_rows_are_camera_after_camera_and_survive_the_store() -> None:
    store, truth = there_and_back(2)
    fresh = NodeImages(store, CONFIG, Silent())
    seen = [fresh.view(row) for row in (3, len(truth) + 3)]
    fresh.keep(store, fresh.learn_words())
    again = NodeImages(store, CONFIG, Silent())
    assert again.camera_of.tolist() == [0] * len(truth) + [1] * len(truth)
    assert again.node_of.tolist() == [*range(len(truth))] * 2
    for row, view in zip((3, len(truth) + 3), seen, strict=True):
        stored = again.view(row)
        assert stored is not None
        assert view is not None
        assert np.allclose(stored.pixels, view.pixels, atol=1e-3)
        assert np.array_equal(stored.words, view.words)
        assert np.array_equal(stored.camera.base_from_camera, view.camera.base_from_camera)


@pytest.mark.parametrize("number", [0, 1])
def test_joined_features_come_apart_again(number: int) -> None:
    room = Room()
    pose = planar_pose(3.0, 2.5, 0.2)
    parts = [extract_features(i, CONFIG) for i in (room.image(pose), backwards(room, pose, 0))]
    joined = joined_features(parts, WIDTH)
    assert len(joined.pixels) == sum(len(part.pixels) for part in parts)
    own = features_of_camera(joined, number, WIDTH)
    assert np.allclose(own.pixels, parts[number].pixels, atol=1e-4)
    assert np.array_equal(own.descriptors, parts[number].descriptors)
