"""Worlds, rays, routes and the driver: analytic rooms, limits, and refusals."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from mapmyworld.errors import WorldError
from mapmyworld.simulation import WORLDS, find_world, simulate
from mapmyworld.simulation.driver import TICK, drive_route
from mapmyworld.simulation.floor_plan import plan_at
from mapmyworld.simulation.robot_settings import (
    CameraSettings,
    DriverSettings,
    ImuSettings,
    OdometrySettings,
    SimulationSettings,
)
from mapmyworld.simulation.route import read_route
from mapmyworld.simulation.solids import GLASS, Box, Opening, Post, wall
from mapmyworld.simulation.textures import make_texture
from mapmyworld.simulation.world import Ground, World, build_scene

LASER_ONLY = SimulationSettings(
    camera=CameraSettings(enabled=False),
    imu=ImuSettings(enabled=False),
    odometry=OdometrySettings(rate=2.0),
)


def box_room(width: float = 6.0, depth: float = 4.0) -> World:
    """A room centred on the origin whose inner faces are at +-width/2 and +-depth/2."""
    x, y, t = width / 2, depth / 2, 0.12
    return World(
        "room",
        "four walls",
        (
            *wall((-x - t, -y - t / 2), (x + t, -y - t / 2), "brick"),
            *wall((x + t / 2, -y), (x + t / 2, y), "brick"),
            *wall((x + t, y + t / 2), (-x - t, y + t / 2), "brick"),
            *wall((-x - t / 2, y), (-x - t / 2, -y), "brick"),
        ),
        (Ground((-x, -y, x, y), "planks", "plain:white"),),
        {"default": "1,0 1,1 0,0"},
    )


def analytic_range(x: float, y: float, angle: float, width: float, depth: float) -> float:
    """From inside a centred rectangle to its border."""
    c, s = np.cos(angle), np.sin(angle)
    along_x = ((width / 2) * np.sign(c) - x) / c if abs(c) > 1e-12 else np.inf
    along_y = ((depth / 2) * np.sign(s) - y) / s if abs(s) > 1e-12 else np.inf
    return float(min(along_x, along_y))


@settings(max_examples=200)
@given(st.floats(-2.9, 2.9), st.floats(-1.9, 1.9), st.floats(-np.pi, np.pi))
def test_rays_in_a_box_room_are_right_to_a_tenth_of_a_millimetre(
    x: float, y: float, angle: float
) -> None:
    plan = ROOM_PLAN
    ranges, _ = plan.cast(np.array([[x, y, angle]]))
    assert ranges[0] == pytest.approx(analytic_range(x, y, angle, 6.0, 4.0), abs=1e-4)


ROOM_PLAN = plan_at(build_scene(box_room()), 0.3)


def plain_cast(segments: np.ndarray, ray: np.ndarray) -> float:
    """Every segment in turn, by solving for the crossing: the relaxation of the kernel."""
    way = np.array([np.cos(ray[2]), np.sin(ray[2])])
    best = np.inf
    for x0, y0, x1, y1 in segments:
        matrix = np.column_stack([way, [x0 - x1, y0 - y1]])
        if abs(np.linalg.det(matrix)) < 1e-12:
            continue
        distance, share = np.linalg.solve(matrix, np.array([x0, y0]) - ray[:2])
        if distance >= 0 and -1e-9 <= share <= 1 + 1e-9:
            best = min(best, float(distance))
    return best


def test_walking_through_cells_finds_what_trying_every_segment_finds() -> None:
    plan = plan_at(build_scene(find_world("apartment")), 0.325)
    random = np.random.default_rng(3)
    rays = np.column_stack([random.uniform(-1, 8, (60, 2)), random.uniform(-3, 3, 60)])
    rays[:, 1] = rays[:, 1] % 4.0 - 1.0
    ranges, _ = plan.cast(rays)
    for ray, found in zip(rays, ranges, strict=True):
        expected = plain_cast(plan.segments, ray)
        if np.isfinite(expected):
            assert found == pytest.approx(expected, abs=1e-9)
        else:
            assert np.isinf(found)


def test_a_door_lets_the_laser_through_and_its_lintel_does_not_hang_in_the_way() -> None:
    solids = wall((0.0, -2.0), (0.0, 2.0), "brick", [Opening(2.0, 1.0)])
    plan = plan_at(build_scene(World("w", "", solids, ())), 0.3)
    through, beside = plan.cast(np.array([[-1.0, 0.0, 0.0], [-1.0, 0.7, 0.0]]))[0]
    assert np.isinf(through)
    assert beside == pytest.approx(1.0 - 0.06)


def test_things_above_and_below_the_laser_are_not_seen() -> None:
    solids = (
        Box(1.0, 0.0, 0.2, 0.2, 0.5, 1.0, "wood"),
        Box(2.0, 0.0, 0.2, 0.2, 0.0, 0.2, "wood"),
        Post(3.0, 0.0, 0.1, 0.0, 1.0, "wood"),
    )
    plan = plan_at(build_scene(World("w", "", solids, ())), 0.3)
    assert plan.cast(np.zeros((1, 3)))[0][0] == pytest.approx(2.9)


@pytest.mark.parametrize("name", list(WORLDS))
def test_every_route_of_every_world_can_be_driven(name: str) -> None:
    world = find_world(name)
    for route in world.routes:
        recording = simulate(name, route=route, laps=1, settings=LASER_ONLY)
        assert recording.truth.drive.length > 5.0
        if route == "default":
            assert recording.truth.drive.poses[0].tolist() == [0.0, 0.0, 0.0]


def test_every_texture_of_every_world_can_be_painted() -> None:
    """One of each kind, and every plain colour: routes are driven without a camera."""
    names = {name for world in WORLDS.values() for name in build_scene(world).faces.texture}
    kinds = {name if name.startswith("plain") else name.split(":")[0]: name for name in names}
    assert kinds.pop(GLASS) == GLASS
    for name in kinds.values():
        assert make_texture(name).pixels.any()


def test_the_driver_keeps_to_the_robots_limits_and_never_jumps() -> None:
    limits = DriverSettings()
    drive = drive_route(read_route("3,0 3,3 <3,0 turn:-135 wait:1 0,0"), limits)
    speeds, turns = np.abs(drive.speeds).T
    assert speeds.max() <= limits.speed + 1e-9
    assert turns.max() <= limits.turn_rate + 1e-9
    gains = np.abs(np.diff(drive.speeds, axis=0)) / TICK
    assert gains[:, 0].max() <= limits.acceleration + 1e-6
    assert gains[:, 1].max() <= limits.turn_acceleration + 1e-6
    steps = np.hypot(*np.diff(drive.poses[:, :2], axis=0).T)
    assert steps.max() <= limits.speed * TICK + 1e-9
    assert (drive.speeds[:, 0] < -0.1).any()
    assert np.hypot(*drive.poses[-1, :2]) < 0.5


def test_a_kidnapped_robot_is_elsewhere_while_its_wheels_stood_still() -> None:
    drive = drive_route(read_route("2,0 kidnap:5,5,90 5,7"), DriverSettings())
    (jump,) = drive.jumps
    assert drive.poses[jump].tolist() == pytest.approx([5.0, 5.0, np.pi / 2])
    around = np.array([jump - 1, jump]) * TICK
    assert np.abs(np.diff(drive.travel(around), axis=0)).max() < 0.01
    just_before = drive.at(np.array([(jump - 0.5) * TICK]))[0]
    assert just_before[0] < 2.5


@pytest.mark.parametrize(
    ("route", "said"),
    [
        ("", "nowhere"),
        ("3,0 fly:1,2", "fly:1,2"),
        ("3,0 1", "'1'"),
        ("nan,0", "nan,0"),
        ("1,0 start:0,0,0", "first word"),
        ("9,0", "near"),
        ("attic", "default"),
    ],
)
def test_a_route_that_makes_no_sense_is_refused_in_words(route: str, said: str) -> None:
    with pytest.raises(WorldError, match=said):
        simulate(box_room(), route=route, settings=LASER_ONLY)


def test_an_unknown_world_or_texture_is_refused_with_what_there_is() -> None:
    with pytest.raises(WorldError, match="apartment"):
        find_world("castle")
    from mapmyworld.simulation.textures import make_texture

    with pytest.raises(WorldError, match="brick"):
        make_texture("gold")
    with pytest.raises(WorldError, match="cream"):
        make_texture("plain:pink")
