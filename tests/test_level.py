"""A carried camera's map: its z axis is up and 0 at the floor, however the camera was held."""

from __future__ import annotations

import functools
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from memory_store import MemoryStore
from numpy.typing import NDArray
from visual_rooms import Room, planar_pose

from formats.database import open_store
from formats.logs import open_log
from mapmyworld.api import Silent
from mapmyworld.config import Config
from mapmyworld.geometry.rigid import between, invert, make_transform, transform_points
from mapmyworld.geometry.rotations import so3_exp
from mapmyworld.mapping.depth_grid import levelled_image, scan_from_depth
from mapmyworld.mapping.level_surfaces import (
    Level,
    Surfaces,
    find_level,
    joined,
    surfaces_of,
    up_as_held,
)
from mapmyworld.odometry.gravity_direction import GravityDirection
from mapmyworld.pipeline import build_map
from mapmyworld.stages.level_map import levelled_poses
from mapmyworld.types import (
    ConstraintKind,
    ImageMessage,
    ImuSample,
    Judged,
    Node,
    NodeData,
    Person,
    Poses,
    RgbdImage,
    Scan,
)

Array = NDArray[np.float64]
CONFIG = Config()
ROOM = Room((6.0, 5.0, 2.5))
UP = np.array([0.0, 0.0, 1.0])
ANGLES = st.floats(-0.6, 0.6)


def carried(image: RgbdImage) -> RgbdImage:
    """The same image of a camera that is its own base."""
    return replace(image, camera=replace(image.camera, base_from_camera=np.eye(4)))


def seen_in_room(map_from_world: Array) -> Surfaces:
    """What a level camera sees of the room, turning on the spot, in a map laid askew."""
    views = room_views()
    return joined(surfaces_of(image, map_from_world @ pose, CONFIG) for image, pose in views)


@functools.cache
def room_views() -> list[tuple[RgbdImage, Array]]:
    """Six images of a carried camera, level, with its poses in the world."""
    turns = np.linspace(0.0, 2.0 * np.pi, 6, endpoint=False)
    return [view(float(yaw), 0.0) for yaw in turns]


def view(yaw: float, down: float) -> tuple[RgbdImage, Array]:
    """An image of the room taken from its middle, and the camera's pose."""
    camera = ROOM.camera()
    turned = make_transform(so3_exp([0.0, down, 0.0]), np.zeros(3))
    mount = make_transform(np.eye(3), camera.base_from_camera[:3, 3])
    pose = planar_pose(3.0, 2.5, yaw) @ mount @ turned @ invert(mount) @ camera.base_from_camera
    _, depth = ROOM.look(pose)
    deep = ImageMessage(0, "camera", "32FC1", camera.width, camera.height, lambda: depth)
    held = replace(camera, base_from_camera=np.eye(4))
    return RgbdImage(held, None, deep), pose


def tilt(level: Level, map_from_world: Array) -> float:
    """Degrees between the level's z and what is truly up."""
    up = level.level_from_map[:3, :3] @ map_from_world[:3, :3] @ UP
    return float(np.degrees(np.arccos(min(1.0, up[2]))))


@settings(max_examples=8, deadline=None)
@given(ANGLES, ANGLES, st.floats(-3.0, 3.0))
def test_a_map_laid_askew_becomes_level_with_its_floor_at_zero(
    roll: float, pitch: float, yaw: float
) -> None:
    turned = so3_exp([0.0, 0.0, yaw]) @ so3_exp([0.0, pitch, 0.0]) @ so3_exp([roll, 0.0, 0.0])
    askew = make_transform(turned, np.array([0.3, -0.2, 0.7]))
    level = find_level(seen_in_room(askew), askew[:3, :3] @ UP, None)
    assert tilt(level, askew) < 0.2
    floor = transform_points(level.level_from_map @ askew, np.array([[3.0, 2.5, 0.0]]))
    assert abs(floor[0, 2]) < 0.02


@pytest.mark.parametrize("down", [0.4, 0.9])
def test_pictures_held_downwards_do_not_mislead(down: float) -> None:
    views = [view(yaw, down) for yaw in (0.2, 0.5, 0.9)]
    seen = joined(surfaces_of(image, pose, CONFIG) for image, pose in views)
    level = find_level(seen, up_as_held(np.stack([pose[:3, :3] for _, pose in views])), None)
    assert tilt(level, np.eye(4)) < 0.2
    assert abs(level.level_from_map[2, 3]) < 0.02


def test_a_table_is_not_the_floor() -> None:
    image, pose = view(0.3, 0.4)
    random = np.random.default_rng(3)
    table = np.column_stack([random.uniform(2.0, 3.5, (3000, 2)), np.full(3000, 0.75)])
    tables = Surfaces(table, np.tile(UP, (3000, 1)))
    both = joined([surfaces_of(image, pose, CONFIG), tables])
    level = find_level(both, UP, None)
    assert abs(level.level_from_map[2, 3]) < 0.02


def test_a_ceiling_alone_indicates_what_is_up_and_no_floor() -> None:
    random = np.random.default_rng(3)
    ceiling = np.column_stack([random.uniform(0.0, 4.0, (3000, 2)), np.full(3000, 2.5)])
    level = find_level(Surfaces(ceiling, np.tile(-UP, (3000, 1))), so3_exp([0.2, 0, 0]) @ UP, None)
    assert tilt(level, np.eye(4)) < 0.1
    assert level.level_from_map[2, 3] == 0.0
    assert "no floor" in level.reason


def test_where_nothing_is_level_an_accelerometer_indicates_else_how_pictures_were_held() -> None:
    random = np.random.default_rng(5)
    normals = random.normal(size=(4000, 3))
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    round_things = Surfaces(random.uniform(-1, 1, (4000, 3)), normals)
    leaning = so3_exp([0.3, 0.0, 0.0]) @ UP
    for seen in (round_things, joined([])):
        held = find_level(seen, leaning, None)
        assert "no level surface" in held.reason
        by_force = find_level(seen, UP, leaning * 9.81)
        assert "accelerometer" in by_force.reason
        for level in (held, by_force):
            np.testing.assert_allclose(level.level_from_map[:3, :3] @ leaning, UP, atol=1e-12)


@pytest.mark.parametrize("down", [0.0, 0.9])
def test_pictures_are_held_upright_however_far_down_they_look(down: float) -> None:
    turned = np.stack([view(yaw, down)[1][:3, :3] for yaw in (0.0, 1.0, 2.0, 3.5)])
    np.testing.assert_allclose(up_as_held(turned), UP, atol=0.02)
    single = up_as_held(turned[:1])
    np.testing.assert_allclose(single, -turned[0, :, 1], atol=1e-9)


@pytest.mark.parametrize("seed", range(40))
def test_a_camera_rolled_to_and_fro_does_not_stand_the_map_on_its_head(seed: int) -> None:
    """It looks 0.7 rad down and turns about all of its axes, as in TUM's "rpy"."""
    random = np.random.default_rng(seed)
    start = view(0.0, 0.7)[1][:3, :3]
    turns = random.uniform(-1.0, 1.0, (30, 3)) * [0.7, 0.7, 1.0]
    held = up_as_held(np.stack([start @ so3_exp(turn) for turn in turns]))
    assert np.degrees(np.arccos(held @ UP)) < 60.0  # what surfaces are looked for around


def test_a_camera_that_looks_straight_down_has_its_back_to_what_is_up() -> None:
    turned = np.stack([view(yaw, np.pi / 2)[1][:3, :3] for yaw in (0.0, 1.0, 2.0, 3.5, 5.0)])
    np.testing.assert_allclose(up_as_held(turned), UP, atol=0.05)


def test_a_force_indicates_a_slanted_roof_from_a_floor() -> None:
    """Most surfaces lean by 20 degrees, as under a roof; the accelerometer knows better."""
    random = np.random.default_rng(7)
    roof = Surfaces(
        random.uniform(-1, 1, (4000, 3)), np.tile(so3_exp([0.35, 0, 0]) @ UP, (4000, 1))
    )
    ground = np.column_stack([random.uniform(-2, 2, (500, 2)), np.full(500, -1.4)])
    seen = joined([roof, Surfaces(ground, np.tile(UP, (500, 1)))])
    level = find_level(seen, UP, so3_exp([0.02, 0.0, 0.0]) @ UP * 9.81)
    assert tilt(level, np.eye(4)) < 0.1
    assert level.level_from_map[2, 3] == pytest.approx(1.4, abs=0.02)


def sample(force: Array) -> ImuSample:
    return ImuSample(0, np.zeros(3), force)


def test_shaking_cancels_out_and_gravity_stays() -> None:
    random, felt = np.random.default_rng(1), GravityDirection()
    for _ in range(400):
        turned = make_transform(so3_exp(random.normal(0.0, 0.4, 3)), np.zeros(3))
        shaken = 9.81 * UP + random.normal(0.0, 2.0, 3)
        felt.add([sample(turned[:3, :3].T @ shaken)], turned)
    mean = felt.mean()
    assert mean is not None
    assert np.degrees(np.arccos(mean[2] / np.linalg.norm(mean))) < 2.0


def test_without_gravity_a_force_indicates_nothing() -> None:
    random, felt = np.random.default_rng(1), GravityDirection()
    assert felt.mean() is None
    for _ in range(400):
        felt.add([sample(random.normal(0.0, 1.0, 3))], np.eye(4))
    assert felt.mean() is None


def ends(scan: Scan, map_from_base: Array) -> Array:
    flat = np.column_stack([scan.points, np.zeros(len(scan.points))])
    return transform_points(map_from_base, flat)[:, :2]


@pytest.mark.parametrize("yaw", [0.3, 2.0])
def test_a_carried_camera_sees_the_walls_where_a_robots_does(yaw: float) -> None:
    base = planar_pose(2.5, 2.0, yaw)
    image = ROOM.image(base)
    upright = ends(scan_from_depth(image, CONFIG), base)
    map_from_camera = base @ image.camera.base_from_camera
    held = levelled_image(carried(image), map_from_camera)
    stood = map_from_camera @ invert(held.camera.base_from_camera)
    found = ends(scan_from_depth(held, CONFIG), stood)
    assert len(upright) > 30
    assert len(found) == len(upright)
    gap = np.linalg.norm(found[:, None] - upright[None], axis=-1).min(axis=1)
    assert gap.max() < 0.05


def beginning(recorded: Path, folder: Path, frames: int) -> Path:
    """A folder like TUM's with the first pictures of another."""
    for name in ("rgb", "depth"):
        (folder / name).mkdir(parents=True)
        lines = (recorded / f"{name}.txt").read_text().splitlines()
        kept = [line for line in lines if not line.startswith("#")][:frames]
        (folder / f"{name}.txt").write_text("\n".join([*kept, ""]))
        for line in kept:
            picture = line.split()[1]
            (folder / picture).write_bytes((recorded / picture).read_bytes())
    return folder


@pytest.mark.slow
@pytest.mark.real_log
def test_a_recorded_hand_held_drive_stands_on_its_floor(data: Path, tmp_path: Path) -> None:
    """The motion capture says 1.57 m for the first pose's height above the floor of the room."""
    folder = beginning(data / "rgbd" / "freiburg1_rpy_15hz", tmp_path / "rpy", 120)
    with open_store(tmp_path / "rpy.db", create=True) as store:
        build_map(open_log([folder]), store, CONFIG, Silent())
        poses, grid = store.poses(), store.grid()
    assert poses is not None
    assert grid is not None
    assert poses.map_from_node[0, 2, 3] == pytest.approx(1.57, abs=0.06)
    free = np.count_nonzero(grid.log_odds < 0.0) * grid.resolution**2
    assert free > 1.5  # m^2 of floor around the desks; 0.2 before maps were levelled


def carried_map(poses: Array, images: list[RgbdImage]) -> MemoryStore:
    """A map of nodes whose poses were tracked askew."""
    store = MemoryStore()
    with store.write_stage("track", "t"):
        for k, (pose, image) in enumerate(zip(poses, images, strict=True)):
            store.add_node(Node(k + 1, 0, k * 10**9, pose, pose), NodeData(images=(image,)))
    return store


def test_solved_poses_become_level_and_motions_stay() -> None:
    views = room_views()
    askew = make_transform(so3_exp([0.2, -0.3, 0.4]), np.array([0.1, 0.2, 0.3]))
    poses = np.stack([askew @ pose for _, pose in views])
    store = carried_map(poses, [image for image, _ in views])
    found, notes = levelled_poses(store, Poses(np.arange(1, 7), poses), (), CONFIG)
    assert len(notes) == 1
    assert notes[0].startswith("hand-held camera: gravity estimated from ")
    assert notes[0].endswith("; its first pose is 1.20 m high")
    height = views[0][1][2, 3]
    np.testing.assert_allclose(found.map_from_node[:, 2, 3], height, atol=0.02)
    before, after = between(poses[:-1], poses[1:]), found.map_from_node
    np.testing.assert_allclose(between(after[:-1], after[1:]), before, atol=1e-12)


def test_a_pinned_node_and_a_robot_keep_the_map_where_it_is() -> None:
    views = room_views()
    askew = make_transform(so3_exp([0.2, 0.0, 0.0]), np.zeros(3))
    poses = Poses(np.arange(1, 7), np.stack([askew @ pose for _, pose in views]))
    pin = Judged(
        2, 2, ConstraintKind.PRIOR, poses.map_from_node[1], np.eye(6), Person("pin", "it is there")
    )
    carried_by_hand = carried_map(poses.map_from_node, [image for image, _ in views])
    robot = ROOM.image(planar_pose(3.0, 2.5, 0.0))
    on_wheels = carried_map(poses.map_from_node, [robot] * 6)
    for store, constraints in ((carried_by_hand, (pin,)), (on_wheels, ())):
        found, notes = levelled_poses(store, poses, constraints, CONFIG)
        assert found is poses
        assert notes == ()
