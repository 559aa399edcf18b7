"""`simulate`: a drive through a world, recorded as messages, with the truth beside it."""

from __future__ import annotations

from collections.abc import Collection, Iterator
from dataclasses import dataclass

import numpy as np

from mapmyworld.errors import WorldError
from mapmyworld.geometry.planar import matrix_to_planar, planar_to_matrix
from mapmyworld.parallel import in_threads
from mapmyworld.simulation import robot
from mapmyworld.simulation.clocks import Schedule, make_schedule, random_of
from mapmyworld.simulation.driver import Drive, drive_route
from mapmyworld.simulation.floor_plan import Plan, plan_at, plan_of_segments
from mapmyworld.simulation.message_streams import (
    Messages,
    Stream,
    imu_stream,
    laser_stream,
    odometry_stream,
    static_messages,
)
from mapmyworld.simulation.robot_settings import SimulationSettings
from mapmyworld.simulation.route import read_route
from mapmyworld.simulation.simulated_laser import Laser
from mapmyworld.simulation.truth import Truth
from mapmyworld.simulation.wheel_odometry import disturb_wheels, integrate_wheels, wheel_travel
from mapmyworld.simulation.world import Scene, World, build_scene
from mapmyworld.simulation.worlds import find_world
from mapmyworld.types import Message, Trajectory

_THREADS = 2  # that make messages ahead of the recorder
_CLEARANCE_EVERY = 20  # ticks between checks that nothing is in the way
_BODY_RAYS = 24  # directions in which room for the robot is checked


@dataclass(frozen=True, slots=True, eq=False)
class Recording:
    """A log in the making: `messages` may be called again and gives the same each time."""

    streams: tuple[Stream, ...]
    first: Messages
    """Latched messages, recorded before all others."""
    truth: Truth

    @property
    def duration(self) -> float:
        """Seconds."""
        return self.truth.drive.duration

    def messages(self, topics: Collection[str] | None = None) -> Iterator[tuple[str, Message, int]]:
        """Topic, message and log time in nanoseconds, in the order of recording."""
        for topic, message in self.first:
            if topics is None or topic in topics:
                yield topic, message, self.truth.start_ns
        streams = [s for s in self.streams if topics is None or set(s.topics) & set(topics)]
        times = [stream.schedule.log_times_ns.tolist() for stream in streams]
        moments = sorted((t, i, k) for i, of in enumerate(times) for k, t in enumerate(of))
        in_order = [(streams[i], k) for _, i, k in moments]
        made = in_threads(lambda moment: moment[0].messages(moment[1]), in_order, _THREADS)
        for (log_time_ns, *_), some in zip(moments, made, strict=True):
            for topic, message in some:
                if topics is None or topic in topics:
                    yield topic, message, log_time_ns


def simulate(
    world: str | World | Scene,
    *,
    seed: int = 0,
    route: str | None = None,
    laps: int | None = None,
    settings: SimulationSettings | None = None,
) -> Recording:
    """A recording of a drive through a world, by name, by description or as a ready scene.

    `route`: a name that the world knows, or steps as in `mapmyworld.simulation.route`. The same
    arguments give the same messages to the last bit. Raises `WorldError` where the world or the
    route makes no sense, or the route leads through a wall.
    """
    settings = settings or SimulationSettings()
    known = find_world(world) if isinstance(world, str) else world
    scene = known if isinstance(known, Scene) else build_scene(known)
    drive = _drive(known, route, laps, settings)
    mount = robot.base_from_laser(settings)
    plan = plan_at(scene, float(mount[2, 3]))
    _check_clearance(drive, plan, settings)
    start_ns = round(settings.clock.start * 1e9)
    streams = _streams(scene, plan, drive, settings, seed)
    stamps = np.unique(np.concatenate([s.schedule.stamps_ns for s in streams]))
    poses = planar_to_matrix(drive.at((stamps - start_ns) * 1e-9))
    trajectory = Trajectory(stamps, poses)
    truth = Truth(trajectory, drive, plan, scene, settings, start_ns)
    return Recording(streams, static_messages(settings, start_ns), truth)


def _drive(
    world: World | Scene, route: str | None, laps: int | None, settings: SimulationSettings
) -> Drive:
    if isinstance(world, Scene):
        if route is None:
            raise WorldError(
                "a world of your own needs a route, e.g. --route 'start:0,0,0 2,0 2,3'"
            )
        return drive_route(read_route(route, laps or 1), settings.driver)
    name = "default" if route is None else route
    text = world.routes.get(name, name)
    if text == name and name.isidentifier():
        names = ", ".join(world.routes)
        raise WorldError(f"{world.name} has no route {name!r}: it has {names}")
    default_laps = world.laps if name in {"default", "second"} else 1
    return drive_route(read_route(text, laps or default_laps), settings.driver)


def _streams(
    scene: Scene, plan: Plan, drive: Drive, settings: SimulationSettings, seed: int
) -> tuple[Stream, ...]:
    s = settings

    def schedule(name: str, rate: float, latency: float, margin: float = 0.0) -> Schedule:
        random = random_of(seed, "clock", name)
        return make_schedule(rate, drive.duration - margin, latency, s.clock, random)

    moments = schedule("odometry", s.odometry.rate, s.odometry.latency)
    rolled = wheel_travel(drive, moments.times, s.body)
    reported = disturb_wheels(rolled, moments.times, s.odometry, random_of(seed, "wheels"))
    odometry = integrate_wheels(reported, moments.times, s.odometry, s.body)
    streams = [odometry_stream(odometry, moments, s)]
    if s.imu.enabled:
        streams.append(imu_stream(drive, schedule("imu", s.imu.rate, s.imu.latency), s, seed))
    if s.laser.enabled:
        mount = matrix_to_planar(robot.base_from_laser(s))
        solid = plan_of_segments(plan.segments[~plan.glass], plan.glass[~plan.glass])
        laser = Laser(s.laser, mount, plan, solid)
        sweep_s = s.laser.field_of_view / 360.0 / s.laser.rate
        moments = schedule("laser", s.laser.rate, s.laser.latency + sweep_s, sweep_s)
        streams.append(laser_stream(laser, drive, moments, seed))
    if s.camera.enabled:
        from mapmyworld.simulation.simulated_camera import camera_stream

        moments = schedule("camera", s.camera.rate, s.camera.latency)
        streams.append(camera_stream(scene, drive, moments, s, seed))
    return tuple(streams)


def _check_clearance(drive: Drive, plan: Plan, settings: SimulationSettings) -> None:
    """Refuses a drive on which the robot's body would touch something at the laser's height."""
    poses = drive.poses[::_CLEARANCE_EVERY]
    angles = 2.0 * np.pi * np.arange(_BODY_RAYS) / _BODY_RAYS
    rays = np.repeat(poses, _BODY_RAYS, axis=0)
    rays[:, 2] = np.tile(angles, len(poses))
    ranges = plan.cast(rays)[0].reshape(len(poses), _BODY_RAYS).min(axis=1)
    worst = int(ranges.argmin())
    if ranges[worst] < settings.body.width / 2.0:
        x, y, _ = poses[worst]
        raise WorldError(
            f"the route touches something near {x:.2f},{y:.2f}: keep "
            f"{settings.body.width / 2.0:.2f} m away from walls and furniture"
        )
