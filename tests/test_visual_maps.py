"""Clouds, meshes and scans from depth, where the surfaces are known."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from visual_rooms import FOCAL, HEIGHT, WIDTH, Room, planar_pose

from mapmyworld.config import Config, VisualConfig
from mapmyworld.mapping.cloud_map import build_cloud
from mapmyworld.mapping.depth_grid import scan_from_depth
from mapmyworld.mapping.voxel_map import VoxelMap
from mapmyworld.types import ImageMessage, NodeData, RgbdImage

Array = NDArray[np.float64]


def turning(room: Room, count: int) -> list[tuple[Array, NodeData]]:
    poses = [planar_pose(3.0, 2.5, 2 * np.pi * i / count) for i in range(count)]
    return [(pose, NodeData(images=(room.image(pose),))) for pose in poses]


def distance_to_box(points: NDArray[np.float32], size: tuple[float, float, float]) -> Array:
    return np.min(np.abs(np.stack([points, points - np.array(size)])), axis=(0, 2))


def test_the_cloud_lies_on_the_walls_with_normals_into_the_room() -> None:
    room = Room()
    cloud = build_cloud(turning(room, 24), Config())
    assert len(cloud.points) > 5000
    assert np.quantile(distance_to_box(cloud.points, room.size), 0.95) < 0.005
    assert cloud.normals is not None
    inwards = np.sum(cloud.normals * (np.array([3.0, 2.5, 1.2]) - cloud.points), axis=1)
    assert (inwards > 0).mean() > 0.99
    assert cloud.colours is not None
    assert cloud.colours.std() > 15  # the pictures on the walls, not one grey


def with_depth(image: RgbdImage, depth: NDArray[np.float32]) -> RgbdImage:
    message = ImageMessage(0, "camera", "32FC1", WIDTH, HEIGHT, lambda: depth)
    return RgbdImage(image.camera, image.colour, message)


def test_what_the_next_view_looks_through_is_left_out() -> None:
    """A ghost of 40 x 40 pixels at 1 m in one of three views from the same place."""
    room = Room()
    pose = planar_pose(3.0, 2.5, 0.0)
    image = room.image(pose)
    assert image.depth is not None
    ghostly = np.array(image.depth.pixels())
    ghostly[100:140, 140:180] = 1.0
    views = [image, with_depth(image, ghostly), image]
    config = replace(Config(), visual=replace(VisualConfig(), cloud_views=1))
    cloud = build_cloud([(pose, NodeData(images=(view,))) for view in views], config)
    assert cloud.points[:, 0].min() > 4.5  # the wall before the camera is at x = 6
    alone = build_cloud([(pose, NodeData(images=(views[1],)))], config)
    assert alone.points[:, 0].min() < 4.1


def test_the_cloud_grows_with_the_room_and_not_with_the_log() -> None:
    room = Room()
    twice = build_cloud(turning(room, 12) * 2, Config())
    often = build_cloud(turning(room, 12) * 4, Config())
    assert len(twice.points) == len(often.points)


def test_smaller_voxels_never_give_fewer_points() -> None:
    """And say the same: fine ones were left out where few points fell into each."""
    room, counts = Room(), []
    for voxel in (0.1, 0.05, 0.03, 0.02, 0.01):
        config = replace(Config(), visual=replace(VisualConfig(), cloud_voxel=voxel))
        cloud = build_cloud(turning(room, 12), config)
        assert np.quantile(distance_to_box(cloud.points, room.size), 0.95) < 0.005
        counts.append(len(cloud.points))
    assert counts == sorted(counts)
    assert counts[-1] > 4 * counts[1]


def test_a_point_that_nothing_near_it_confirms_is_left_out_of_fine_voxels_too() -> None:
    voxels = VoxelMap(0.01)
    points = np.array([[0.011, 0, 0], [0.031, 0, 0], [2.0, 0, 0]])
    voxels.add(points, np.zeros((3, 3), np.uint8), np.zeros((3, 3), np.float32))
    assert len(voxels.to_cloud(2).points) == 0
    assert voxels.to_cloud(2, 0.05).points[:, 0] == pytest.approx([0.011, 0.031], abs=1e-4)


def test_a_voxel_holds_the_mean_of_its_points() -> None:
    voxels = VoxelMap(0.1)
    points = np.array([[0.01, 0.02, 0.03], [0.05, 0.06, 0.07], [-0.31, 5.0, 2.0]])
    colours = np.array([[0, 10, 20], [100, 30, 40], [7, 8, 9]], np.uint8)
    normals = np.array([[1, 0, 0], [0, 1, 0], [0, 0, 1]], np.float32)
    voxels.add(points, colours, normals)
    cloud = voxels.to_cloud()
    near = np.argmin(np.linalg.norm(cloud.points, axis=1))
    assert cloud.points[near] == pytest.approx([0.03, 0.04, 0.05], abs=0.1 / 500)
    assert cloud.colours is not None
    assert cloud.colours[near].tolist() == [50, 20, 30]
    assert cloud.normals is not None
    assert cloud.normals[near] == pytest.approx([2**-0.5, 2**-0.5, 0], abs=0.01)
    assert len(voxels.to_cloud(2).points) == 1


def test_nothing_makes_an_empty_cloud() -> None:
    assert build_cloud([], Config()).points.shape == (0, 3)


def test_a_scan_from_depth_meets_the_walls_and_not_the_floor() -> None:
    room = Room(size=(6.0, 5.0, 2.5))
    image = room.image(planar_pose(3.0, 2.5, 0.0), height=0.4)
    scan = scan_from_depth(image, Config())
    assert len(scan.points) >= 75
    assert np.abs(scan.points[:, 0] - 3.0).max() < 0.03  # the wall 3 m before the base
    half = np.arctan(WIDTH / 2 / FOCAL)
    bearings = np.arctan2(scan.points[:, 1], scan.points[:, 0])
    assert np.abs(bearings).max() < half + 0.01
    assert np.ptp(bearings) > 1.8 * half
    assert len(scan.missing) == 0


def test_a_low_box_stops_the_beam_and_a_lamp_does_not() -> None:
    """A box 0.2 m high at 1.5 m to the left; a lamp at 2 m height to the right."""
    room = Room(size=(9.0, 5.0, 2.5))
    image = room.image(planar_pose(1.0, 2.5, 0.0), height=0.4)
    assert image.depth is not None
    depth = np.array(image.depth.pixels())
    u, v = np.meshgrid(np.arange(WIDTH), np.arange(HEIGHT))
    z = 0.4 - (v - HEIGHT / 2 + 0.5) / FOCAL * 1.5  # height at 1.5 m distance
    depth[(u < WIDTH // 3) & (z > 0.0) & (z < 0.2)] = 1.5
    lamp = 0.4 - (v - HEIGHT / 2 + 0.5) / FOCAL * 4.0
    depth[(u > 2 * WIDTH // 3) & (lamp > 1.8) & (lamp < 2.1)] = 4.0
    scan = scan_from_depth(with_depth(image, depth), Config())
    left = scan.points[scan.points[:, 1] > 0.35]
    assert len(left) > 10
    assert np.abs(left[:, 0] - 1.5).max() < 0.02
    right = scan.points[scan.points[:, 1] < 0]
    assert (right[:, 1] < -2.4).all()  # the side wall, 2.5 m away, and not the lamp
    assert (scan.missing < -0.1).sum() > 10  # the way below it is free


@pytest.mark.beyond_pip
def test_a_mesh_of_a_wall_is_flat_and_coloured(open3d: Any) -> None:
    from mapmyworld.mapping.mesh_map import build_mesh

    room = Room()
    poses = [planar_pose(3.0, 2.5 + 0.02 * i, 0.0) for i in range(4)]
    mesh = build_mesh([(p, NodeData(images=(room.image(p),))) for p in poses], Config())
    assert len(mesh.triangles) > 1000
    assert np.quantile(distance_to_box(mesh.vertices, room.size), 0.9) < 0.02
    assert mesh.colours is not None
    assert mesh.colours.std() > 15
