"""Several cameras on one robot: features of all of them, kept side by side as RTAB-Map does."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from functools import cache
from pathlib import Path
from typing import cast

import numpy as np
import pytest
from memory_store import MemoryStore
from messages_in_memory import MemoryLog, camera_info_at, image_at, odometry_at, transform
from numpy.typing import NDArray
from test_visual_places import Silent, drifting, translation_errors
from visual_rooms import HEIGHT, WIDTH, Room, planar_pose

from formats.database import open_store
from mapmyworld.config import Config, SensingConfig
from mapmyworld.geometry.planar import matrix_to_planar
from mapmyworld.pipeline import build_map
from mapmyworld.places.node_features import features_of_camera, joined_features
from mapmyworld.places.node_images import NodeImages
from mapmyworld.places.visual_closures import find_visual_closures
from mapmyworld.registration.features import extract_features
from mapmyworld.sensing import make_plan, read_frames, survey_log
from mapmyworld.types import (
    ConstraintKind,
    Judged,
    Message,
    Node,
    NodeData,
    Poses,
    RgbdImage,
    TransformsMessage,
    TransformStamped,
)

Array = NDArray[np.float64]
CONFIG = Config(threads=2)
MS = 1_000_000
Entries = list[tuple[str, Message, int]]
TURNED = planar_pose(0.0, 0.0, np.pi)


def backwards(room: Room, pose: Array) -> RgbdImage:
    """What a second camera sees that looks where the robot came from."""
    image = room.image(pose @ TURNED)
    mount = TURNED @ image.camera.base_from_camera
    return replace(image, camera=replace(image.camera, base_from_camera=mount))


@cache
def there_and_back() -> tuple[tuple[Array, RgbdImage, RgbdImage], ...]:
    """Along a room, then back facing the other way: poses, and what the two cameras see."""
    room = Room(size=(7.0, 5.0, 2.5))
    truth = [planar_pose(2.0 + 0.22 * i, 2.4, 0.0) for i in range(12)]
    truth += [planar_pose(4.4 - 0.22 * i, 2.5, np.pi) for i in range(12)]
    return tuple((p, room.image(p), backwards(room, p)) for p in truth)


def truth() -> list[Array]:
    return [pose for pose, _, _ in there_and_back()]


def store_of(cameras: int) -> MemoryStore:
    """Nodes of the drive with drifting wheels, a second from one to the next."""
    store = MemoryStore()
    drift = drifting(truth(), 0)
    for i, ((_, *images), tracked) in enumerate(zip(there_and_back(), drift, strict=True)):
        node = Node(i + 1, 0, i * 1_000_000_000, tracked, tracked)
        store.add_node(node, NodeData(images=tuple(images[:cameras])))
    return store


def across(constraints: Sequence[Judged]) -> list[Judged]:
    """Those between the way there and the way back."""
    return [c for c in constraints if min(c.from_id, c.to_id) <= 12 < max(c.from_id, c.to_id)]


def test_a_camera_that_looks_back_recognises_what_the_other_one_saw() -> None:
    alone, both = (
        [c for c in find_visual_closures(store_of(k), None, CONFIG, Silent()) if c.accepted]
        for k in (1, 2)
    )
    assert not across(alone)
    assert len(across(both)) >= 5
    assert max(translation_errors([*alone, *both], truth())) < 0.1
    pairs = [frozenset((c.from_id, c.to_id)) for c in both]
    assert len(set(pairs)) == len(pairs)


def test_solved_poses_bring_images_of_different_cameras_together() -> None:
    """As the optimiser asks it: features come from the store, with words, from both cameras."""
    store = store_of(2)
    images = NodeImages(store, CONFIG, Silent())
    images.keep(store, images.learn_words())
    poses = Poses(np.arange(1, len(truth()) + 1), np.stack(truth()))
    found = find_visual_closures(store, poses, CONFIG, Silent())
    near = [c for c in found if c.accepted and abs(c.from_id - c.to_id) > 6]
    assert near
    assert max(translation_errors(near, truth())) < 0.1


def test_rows_are_camera_after_camera_and_survive_the_store() -> None:
    store, count = store_of(2), len(truth())
    fresh = NodeImages(store, CONFIG, Silent())
    seen = [fresh.view(row) for row in (3, count + 3)]
    fresh.keep(store, fresh.learn_words())
    again = NodeImages(store, CONFIG, Silent())
    assert again.camera_of.tolist() == [0] * count + [1] * count
    assert again.node_of.tolist() == [*range(count)] * 2
    for row, view in zip((3, count + 3), seen, strict=True):
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
    parts = [extract_features(i, CONFIG) for i in (room.image(pose), backwards(room, pose))]
    joined = joined_features(parts, WIDTH)
    assert len(joined.pixels) == sum(len(part.pixels) for part in parts)
    own = features_of_camera(joined, number, WIDTH)
    assert np.allclose(own.pixels, parts[number].pixels, atol=1e-4)
    assert np.array_equal(own.descriptors, parts[number].descriptors)


def two_cameras(mount: bool, size: tuple[int, int] = (64, 48)) -> Entries:
    """Half a second of a camera to the front, one to the back, and wheels at 1 m/s."""
    entries: Entries = [("/tf_static", transform("base_link", "front_optical", (0.1, 0, 0)), 0)]
    if mount:
        entries += [("/tf_static", transform("base_link", "rear_optical", (-0.1, 0, np.pi)), 0)]
    for t in range(0, 501, 10):
        entries.append(("/odom", odometry_at(t * MS, (t * 0.001, 0, 0)), t * MS))
    for t in range(0, 500, 100):
        for name, late, shape in (("front", 0, (64, 48)), ("rear", 30, size)):
            at = (t + late) * MS
            frame = f"{name}_optical"
            entries += [
                (f"/{name}/image", image_at(at, "rgb8", shape, frame), at),
                (f"/{name}/depth", image_at(at, "16UC1", shape, frame), at),
                (f"/{name}/camera_info", camera_info_at(at, shape, frame), at),
            ]
    return sorted(entries, key=lambda entry: entry[2])


def test_a_second_camera_that_looks_elsewhere_joins_the_first() -> None:
    log = MemoryLog(two_cameras(mount=True))
    plan = make_plan(survey_log(log), SensingConfig())
    assert plan.camera is not None
    assert plan.camera.colour_topic == "/front/image"
    assert [c.colour_topic for c in plan.more_cameras] == ["/rear/image"]
    assert {"/rear/image", "/rear/depth"} <= set(plan.topics)
    frames = list(read_frames(log, plan, SensingConfig()))
    assert [len(frame.images) for frame in frames] == [2] * 5
    front, rear = (image.camera.base_from_camera for image in frames[1].images)
    assert front[0, 3] == pytest.approx(0.1)
    assert rear[0, 3] == pytest.approx(-0.1 + 0.03)  # 30 ms later, carried by the odometry
    assert rear[0, 0] == pytest.approx(-1.0)


@pytest.mark.parametrize(("mount", "size"), [(False, (64, 48)), (True, (32, 24))])
def test_a_second_camera_of_no_known_place_or_another_size_is_left_out(
    mount: bool, size: tuple[int, int]
) -> None:
    log = MemoryLog(two_cameras(mount, size))
    plan = make_plan(survey_log(log), SensingConfig())
    assert plan.camera is not None
    assert plan.more_cameras == ()
    assert [len(frame.images) for frame in read_frames(log, plan, SensingConfig())] == [1] * 5


def filmed() -> MemoryLog:
    """The drive there and back as a log of two cameras and drifting wheels, a frame a second."""
    entries = cast("Entries", [])
    drift = drifting(truth(), 0)
    for i, ((_, *images), tracked) in enumerate(zip(there_and_back(), drift, strict=True)):
        at = (i + 1) * 1_000_000_000
        entries.append(("/odom", odometry_at(at, matrix_to_planar(tracked).tolist()), at))
        for name, image in zip(("front", "rear"), images, strict=True):
            frame = f"{name}_optical"
            mount = TransformStamped(0, "base_link", frame, image.camera.base_from_camera)
            k = image.camera.intrinsics
            info = replace(
                camera_info_at(at, (WIDTH, HEIGHT), frame),
                intrinsics=k, projection=np.hstack([k, np.zeros((3, 1))]),
            )  # fmt: skip
            assert image.colour is not None
            assert image.depth is not None
            entries += [
                ("/tf_static", TransformsMessage((mount,), True), at),
                (f"/{name}/image", replace(image.colour, stamp_ns=at, frame_id=frame), at),
                (f"/{name}/depth", replace(image.depth, stamp_ns=at, frame_id=frame), at),
                (f"/{name}/camera_info", info, at),
            ]
    return MemoryLog(entries)


@pytest.mark.slow
def test_a_map_of_two_cameras_is_closed_by_both(tmp_path: Path) -> None:
    """From the log to the database and back: what wheels indicate is corrected on the way back."""
    with open_store(tmp_path / "two.db", create=True) as store:
        build_map(filmed(), store, CONFIG, Silent())
        across = [
            c
            for c in store.constraints()
            if c.accepted
            and c.kind is not ConstraintKind.NEIGHBOUR
            and abs(c.to_id - c.from_id) > 6
        ]
        poses, data = store.poses(), store.node_data(3)
    assert len(across) >= 5
    assert len(data.images) == 2
    assert data.features is not None
    assert (data.features.pixels[:, 0] > WIDTH).any()
    assert poses is not None
    places = np.stack(truth())[:, :2, 3]
    miss = np.linalg.norm(poses.map_from_node[:, :2, 3] - places, axis=1)
    wheels = np.stack(drifting(truth(), 0))[:, :2, 3] - places
    assert miss.max() < 0.5 * np.linalg.norm(wheels, axis=1).max()
