"""The way that a depth camera sees to be free: floor in view, without a gap, and nothing on it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray
from visual_rooms import FOCAL, HEIGHT, LEVEL, WIDTH, Room, planar_pose

from mapmyworld.config import Config
from mapmyworld.geometry.rigid import make_transform
from mapmyworld.geometry.rotations import so3_exp
from mapmyworld.mapping.depth_grid import planar_scan, scan_from_depth
from mapmyworld.mapping.occupancy import build_grid
from mapmyworld.types import ImageMessage, RgbdImage, Scan

Array = NDArray[np.float64]
HALL = Room(size=(30.0, 20.0, 8.0))
BASE = planar_pose(10.0, 10.0, 0.4)
_DOWN = 0.6  # rad by which the camera looks down: 0.29 rad and more below the horizon
_HEIGHT = 0.5  # m
_FARTHEST = _HEIGHT / np.tan(_DOWN - np.arctan(HEIGHT / 2 / FOCAL))  # m, in the middle


def looking_down(room: Room = HALL, down: float = _DOWN) -> RgbdImage:
    """From a camera that sees the floor and no wall."""
    mount = make_transform(so3_exp([0.0, down, 0.0]) @ LEVEL, np.array([0.1, 0.0, _HEIGHT]))
    camera = replace(room.camera(), base_from_camera=mount)
    _, depth = room.look(BASE @ mount)
    return with_depth(replace(room.image(BASE), camera=camera), depth)


def with_depth(image: RgbdImage, depth: NDArray[np.float32]) -> RgbdImage:
    deep = ImageMessage(0, "camera", "32FC1", WIDTH, HEIGHT, lambda: depth)
    return replace(image, depth=deep)


def depth_of(image: RgbdImage) -> NDArray[np.float32]:
    assert image.depth is not None
    return np.array(image.depth.pixels(), np.float32)


def passed(scan: Scan) -> Array:
    """Ranges (N,) of the beams that met nothing, from the camera."""
    return np.asarray(np.linalg.norm(scan.passed - scan.origin[:2], axis=1), np.float64)


def test_bare_floor_is_free_as_far_as_it_is_seen_and_no_farther() -> None:
    scan = scan_from_depth(looking_down(), Config())
    assert len(scan.points) == 0
    assert len(scan.passed) > 40
    ahead = np.abs(scan.passed[:, 1]) < 0.1
    row = 4 / FOCAL * (_FARTHEST**2 + _HEIGHT**2) / _HEIGHT  # m between rows looked at
    assert _FARTHEST - 2 * row < passed(scan)[ahead].max() <= _FARTHEST
    bearings = np.arctan2(scan.passed[:, 1], scan.passed[:, 0] - 0.1)
    assert np.abs(bearings).max() < 1.0  # within the view, which the tilt widens at its lower edge


def test_a_gap_in_the_floor_ends_what_is_known_to_be_free() -> None:
    """Rows without depth, as above a black box or a hole; floor is seen again behind them."""
    image = looking_down()
    depth = depth_of(image)
    rows = slice(HEIGHT // 4, HEIGHT // 2)
    depth[rows] = 0.0
    scan = scan_from_depth(with_depth(image, depth), Config())
    nearest = _HEIGHT / np.tan(_DOWN)  # where the gap begins, in the middle column
    ahead = np.abs(scan.passed[:, 1]) < 0.1
    assert passed(scan)[ahead].max() < nearest + 0.05
    assert passed(scan)[ahead].max() > nearest - 0.1


def test_rows_missing_singly_are_no_gap() -> None:
    image = looking_down()
    depth = depth_of(image)
    depth[::40] = depth[1::40] = depth[2::40] = depth[3::40] = 0.0
    found, whole = (scan_from_depth(i, Config()) for i in (with_depth(image, depth), image))
    assert passed(found).max() > 0.9 * passed(whole).max()


def test_a_beam_with_anything_in_the_way_is_not_free_however_little_it_is() -> None:
    """Two pixels looked at, too few for an obstacle, stand 0.3 m above the floor."""
    image = looking_down()
    depth = depth_of(image)
    u, row = 160, 120
    depth[row : row + 8, u : u + 4] *= 0.4
    scan = scan_from_depth(with_depth(image, depth), Config())
    whole = scan_from_depth(image, Config())
    assert len(scan.points) == 0
    assert 1 <= len(whole.passed) - len(scan.passed) <= 3
    assert np.abs(whole.passed[:, 1]).min() < 0.02
    assert np.abs(scan.passed[:, 1]).min() < 0.05


def test_a_table_top_is_no_floor() -> None:
    """A plane 0.3 m above the floor, all that is seen: obstacles, and nothing free behind them."""
    image = looking_down()
    scan = scan_from_depth(with_depth(image, depth_of(image) * np.float32(0.4)), Config())
    assert len(scan.passed) == 0
    assert len(scan.points) > 40


def test_nothing_is_free_beyond_the_range_of_the_grid() -> None:
    scan = scan_from_depth(
        looking_down(down=0.45), replace(Config(), visual=replace(Config().visual, grid_range=1.0))
    )
    assert 0.9 < passed(scan).max() <= 1.0 + 1e-6


def test_the_grid_draws_free_what_was_seen_to_be_and_only_that() -> None:
    image, config = looking_down(), Config()
    grid = build_grid([planar_scan(image, BASE, config)], config)
    free = grid.log_odds < 0
    assert not (grid.log_odds > 0).any()
    whole = np.arctan(WIDTH / 2 / FOCAL) * _FARTHEST**2  # m^2 of a sector, at the very least half
    assert 0.5 * whole < free.sum() * grid.resolution**2 < 2.0 * whole
    cells = np.argwhere(free)[:, ::-1] * grid.resolution + grid.origin + 0.5 * grid.resolution
    local = (cells - BASE[:2, 3]) @ BASE[:2, :2]
    assert local[:, 0].min() > 0.0  # nothing behind the camera


@pytest.mark.parametrize("yaw", [0.0, 1.1])
def test_what_a_carried_camera_sees_to_be_free_lies_where_a_robots_does(yaw: float) -> None:
    base = planar_pose(10.0, 10.0, yaw)
    robot = looking_down()
    map_from_camera = base @ robot.camera.base_from_camera
    own = replace(robot, camera=replace(robot.camera, base_from_camera=np.eye(4)))
    areas = []
    for image, pose in ((robot, base), (own, map_from_camera)):
        grid = build_grid([planar_scan(image, pose, Config())], Config())
        rows, columns = np.nonzero(grid.log_odds < 0)
        centre = grid.origin + grid.resolution * np.array([columns.mean(), rows.mean()])
        areas.append([len(rows) * grid.resolution**2, *centre])
    assert areas[1] == pytest.approx(areas[0], rel=0.05)
