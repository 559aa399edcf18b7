"""The camera: depth of analytic rooms, features where there is something to see, honest holes."""

from __future__ import annotations

import cv2
import numpy as np
import pytest

from mapmyworld.geometry.planar import planar_to_matrix
from mapmyworld.simulation import SimulationSettings, find_world
from mapmyworld.simulation.image_messages import disturb_colour, disturb_depth
from mapmyworld.simulation.robot import base_from_optical, intrinsics
from mapmyworld.simulation.robot_settings import CameraSettings
from mapmyworld.simulation.solids import wall
from mapmyworld.simulation.world import Ground, World, build_scene, scene_from_mesh

SETTINGS = SimulationSettings()


def renderer(world: World, settings: SimulationSettings = SETTINGS):
    from mapmyworld.simulation.simulated_camera import Renderer

    return Renderer(build_scene(world), settings)


def seen_from(x: float, y: float, yaw_deg: float) -> np.ndarray:
    pose = planar_to_matrix([x, y, np.radians(yaw_deg)])
    return np.asarray(pose @ base_from_optical(SETTINGS))


@pytest.fixture(scope="module")
def hall():
    return renderer(find_world("hall"))


def orb_count(colour: np.ndarray) -> int:
    grey = cv2.cvtColor(colour, cv2.COLOR_RGB2GRAY)
    return len(cv2.ORB_create(1000).detect(grey, None))


def test_depth_in_a_box_room_is_right_to_a_millimetre() -> None:
    """Wall 3 m ahead, floor and ceiling: depth along the axis from the pinhole's geometry."""
    solids = wall((3.06, -9.0), (3.06, 9.0), "brick", height=2.5)
    ground = Ground((-9.0, -9.0, 9.0, 9.0), "planks", "plain:white")
    view = renderer(World("room", "", solids, (ground,))).render(seen_from(0.0, 0.0, 0.0))
    place = base_from_optical(SETTINGS)[:3, 3]
    k = intrinsics(SETTINGS)
    slope = (np.arange(SETTINGS.camera.height) - k[1, 2]) / k[1, 1]
    wall_depth = 3.0 - place[0]
    with np.errstate(divide="ignore"):
        floor = np.where(slope > 0, place[2] / slope, np.inf)
        ceiling = np.where(slope < 0, (place[2] - 2.5) / slope, np.inf)
    expected = np.minimum(np.minimum(floor, ceiling), wall_depth)
    assert np.abs(view.depth - expected[:, None]).max() < 1e-3


def test_rich_sections_have_features_and_blank_walls_have_none(hall) -> None:
    random = np.random.default_rng(0)
    rich = disturb_colour(
        hall.render(seen_from(9.5, 1.0, 0.0)).colour, 1.0, SETTINGS.camera, random
    )
    blank = disturb_colour(
        hall.render(seen_from(4.4, -0.6, -90.0)).colour, 1.0, SETTINGS.camera, random
    )
    assert orb_count(rich) >= 300
    assert orb_count(blank) < 50


def test_repeating_sections_look_exactly_the_same(hall) -> None:
    """The same two pictures again, one period on: the images agree but for rounding."""
    first = hall.render(seen_from(7.15, 0.0, -90.0)).colour[:, 220:420].astype(int)
    again = hall.render(seen_from(9.75, 0.0, -90.0)).colour[:, 220:420].astype(int)
    assert np.abs(first - again).mean() < 2.0


def test_glass_is_looked_through() -> None:
    """Through the pane beside the door of the lounge the camera sees the balcony's railing."""
    view = renderer(find_world("apartment")).render(seen_from(2.2, 1.0, 90.0))
    middle = view.depth[SETTINGS.camera.height // 2, SETTINGS.camera.width // 2]
    assert middle == pytest.approx(4.8 - 0.03 - 1.2, abs=0.02)


def test_the_same_pose_gives_the_same_pixels(hall) -> None:
    pose = seen_from(2.0, 1.0, 30.0)
    first, second = hall.render(pose), hall.render(pose)
    assert (first.colour == second.colour).all()
    assert first.depth.tobytes() == second.depth.tobytes()


def test_depth_noise_grows_with_the_square_of_the_distance() -> None:
    camera = CameraSettings()
    slant = np.ones((200, 200), np.float32)
    for metres in (1.0, 4.0):
        clean = np.full((200, 200), metres, np.float32)
        measured = disturb_depth(clean, slant, camera, np.random.default_rng(1))
        assert measured.std() == pytest.approx(camera.depth_noise * metres**2, rel=0.05)
        assert measured.mean() == pytest.approx(metres, abs=1e-3)


def test_depth_is_missing_at_edges_far_away_and_at_grazing_angles() -> None:
    camera = CameraSettings()
    clean = np.full((9, 20), 2.0, np.float32)
    clean[:, 10:] = 4.0
    clean[8] = 20.0
    slant = np.ones((9, 20), np.float32)
    slant[:2] = 0.05
    measured = disturb_depth(clean, slant, camera, np.random.default_rng(1))
    assert (measured[:2] == 0).all()
    assert (measured[8] == 0).all()
    assert (measured[3:6, 9:11] == 0).all()
    assert (measured[3:6, :8] > 0).all()


def test_a_users_mesh_is_seen_in_its_own_colours() -> None:
    from mapmyworld.simulation.simulated_camera import Renderer
    from mapmyworld.types import Mesh

    corners = np.array([[2, -9, -9], [2, 9, -9], [2, 0, 18]], np.float32)
    red = np.tile(np.array([200, 0, 0], np.uint8), (3, 1))
    mesh = Mesh(corners, np.array([[0, 2, 1]], np.int32), red)
    view = Renderer(scene_from_mesh(mesh), SETTINGS).render(seen_from(0.0, 0.0, 0.0))
    pixel = view.colour[240, 320]
    assert pixel[0] > 120
    assert pixel[1] == pixel[2] == 0
    assert view.depth[240, 320] == pytest.approx(1.8, abs=1e-3)
