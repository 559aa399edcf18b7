"""Drives through drawn buildings, written as robots of the year 2000 recorded them (CARMEN).

The robot goes round the outermost corridors first, then through the others. Its laser sees half a
turn in steps of a degree, to the centimetre or to five, 2 to 10 times a second. Its wheels turn it
too far or too little, and wander.
"""

from __future__ import annotations

import itertools
from dataclasses import replace
from pathlib import Path

import numpy as np
from buildings import Box, Building, Junction, draw_building, walls
from numpy.typing import NDArray

from mapmyworld.geometry.planar import wrap_angle
from mapmyworld.simulation.driver import Drive, drive_route
from mapmyworld.simulation.floor_plan import Plan, plan_of_segments
from mapmyworld.simulation.robot_settings import BodySettings, DriverSettings, OdometrySettings
from mapmyworld.simulation.route import Step
from mapmyworld.simulation.wheel_odometry import disturb_wheels, wheel_travel

Array = NDArray[np.float64]
ANGLES = np.radians(np.arange(-90.0, 90.0))
NO_RETURN = 81.91  # m


def write_log(number: int, log: Path, truth: Path, *, bare: bool = False) -> str:
    """Draws building, robot and drive, writes log and truth; the head of its row of the table."""
    random = np.random.default_rng(number)
    building = draw_building(random, bare=bare)
    loop = 2.0 * (building.lines[0][-1] + building.lines[1][-1])
    longest = min(1900.0, loop * random.uniform(1.3, 4.0))
    driver = DriverSettings(speed=random.uniform(0.3, 1.0), turn_rate=random.uniform(0.4, 1.2))
    drive, plan = draw_drive(random, building, longest, driver)
    rate = float(random.choice([2.0, 3.0, 5.0, 10.0]))
    resolution = float(random.choice([0.01, 0.01, 0.05]))
    reach = float(random.choice([81.83, 81.83, 30.0, 8.19]))
    kind, wheels = draw_wheels(random)
    scans = np.arange(0.0, drive.duration, 1.0 / rate)
    scans += random.uniform(0.0, 0.2 / rate, len(scans))
    lag = random.choice([0.0, 0.0, 0.05, 0.1])
    moments = np.arange(-1.0, drive.duration + 1.0, 0.05)
    body = BodySettings()
    rolled = disturb_wheels(wheel_travel(drive, moments, body), moments, wheels, random)
    odometry = integrated(rolled, body.wheel_track * (1.0 + wheels.track_error))
    lines = odometry_lines(moments, odometry)
    at = [np.interp(scans - lag, moments, odometry[:, k]) for k in range(3)]
    noise, lost = random.choice([0.005, 0.01, 0.02]), random.choice([0.001, 0.01])
    for k, stamp in enumerate(scans.tolist()):
        ranges = sweep(plan, drive, stamp) + noise * random.normal(size=180)
        ranges = np.maximum(np.round(ranges / resolution), 1.0) * resolution
        ranges[(ranges > reach) | (random.random(180) < lost)] = NO_RETURN
        words = " ".join(f"{r:.2f}" for r in ranges)
        x, y, yaw = (column[k] for column in at)
        pose = f"{x:.6f} {y:.6f} {wrap_angle(yaw):.6f}"
        lines.append((stamp, f"FLASER 180 {words} {pose} {pose}"))
    lines.sort(key=lambda line: line[0])
    with log.open("w") as file:
        file.write("PARAM robot_frontlaser_offset 0.0 nohost 0\n")
        for stamp, text in lines:
            file.write(f"{text} {1e9 + stamp:.6f} nohost {stamp:.6f}\n")
    with truth.open("w") as file:
        for stamp, (x, y, yaw) in zip(scans.tolist(), drive.at(scans), strict=True):
            turn = f"0 0 {np.sin(yaw / 2):.9f} {np.cos(yaw / 2):.9f}"
            file.write(f"{1e9 + stamp:.6f} {x:.6f} {y:.6f} 0 {turn}\n")
    size = f"{building.lines[0][-1]:.0f} x {building.lines[1][-1]:.0f}"
    return (
        f"| {number} | {size} | {drive.length:.0f} | {loop:.0f} | {rate:g} | {resolution} to "
        f"{reach:g} | {kind}"
    )


def draw_drive(
    random: np.random.Generator, building: Building, longest: float, driver: DriverSettings
) -> tuple[Drive, Plan]:
    """A drive that touches nothing: things in its way are taken away, then rooms are shunned."""
    for visited in (random.choice([0.0, 0.05, 0.2]), 0.0):
        drive = drive_route(draw_route(random, building, longest, visited), driver)
        poses = drive.poses[::40]
        clear = [thing for thing in building.things if is_clear(thing, poses)]
        plan = plan_of_segments(walls(replace(building, things=clear)))
        rays = np.repeat(poses, 24, axis=0)
        rays[:, 2] = np.tile(2.0 * np.pi * np.arange(24) / 24, len(poses))
        if plan.cast(rays)[0].min() > 0.15:
            return drive, plan
    raise SystemExit("the robot cannot drive here")


def is_clear(thing: Box, poses: Array) -> bool:
    """Whether the robot keeps half a metre away."""
    x, y = poses[:, 0], poses[:, 1]
    beside = np.maximum(np.maximum(thing[0] - x, x - thing[2]), 0.0)
    before = np.maximum(np.maximum(thing[1] - y, y - thing[3]), 0.0)
    return bool(np.hypot(beside, before).min() > 0.5)


def draw_route(
    random: np.random.Generator, building: Building, longest: float, visited: float
) -> list[Step]:
    """Round the outermost corridors, then wherever was driven least, and into some rooms."""
    columns, rows = len(building.lines[0]) - 1, len(building.lines[1]) - 1
    ring = [(i, 0) for i in range(columns)] + [(columns, j) for j in range(rows)]
    ring += [(i, rows) for i in range(columns, 0, -1)] + [(0, j) for j in range(rows, 0, -1)]
    first = int(random.integers(len(ring)))
    if random.random() < 0.5:
        ring.reverse()
    way = [ring[(first + k) % len(ring)] for k in range(len(ring) + 1)]
    driven = dict.fromkeys(building.corridors, 0)
    length = 0.0
    k = 0
    while True:
        if k + 1 >= len(way):
            if length > longest:
                break
            way.append(next_junction(random, driven, way))
        corridor = (min(way[k], way[k + 1]), max(way[k], way[k + 1]))
        driven[corridor] += 1
        length += float(np.abs(place(building, way[k]) - place(building, way[k + 1])).sum())
        k += 1
    steps = [Step("start", (*place(building, way[0]).tolist(), heading(building, way[:2])))]
    for a, b in itertools.pairwise(way):
        steps += steps_along(random, building, a, b, visited)
    return steps


def next_junction(
    random: np.random.Generator,
    driven: dict[tuple[Junction, Junction], int], way: list[Junction],
) -> Junction:  # fmt: skip
    """Where the corridor leads that was driven least, not back if that can be helped."""
    choices = []
    for ends, times in sorted(driven.items()):
        if way[-1] in ends:
            other = ends[0] if ends[1] == way[-1] else ends[1]
            choices.append((times + (3.0 if other == way[-2] else 0.0) + random.random(), other))
    return min(choices)[1]


def place(building: Building, junction: Junction) -> Array:
    return np.array([building.lines[0][junction[0]], building.lines[1][junction[1]]])


def heading(building: Building, two: list[Junction]) -> float:
    x, y = place(building, two[1]) - place(building, two[0])
    return float(np.degrees(np.arctan2(y, x)))


def steps_along(
    random: np.random.Generator, building: Building, a: Junction, b: Junction, visited: float
) -> list[Step]:
    """From one junction to the next, not quite in the middle, with looks into rooms."""
    start, end = place(building, a), place(building, b)
    along = (end - start) / np.hypot(*(end - start))
    across = np.array([-along[1], along[0]])
    stops: list[tuple[float, list[Array]]] = [
        (s, [start + s * along + random.uniform(-0.25, 0.25) * across])
        for s in np.arange(random.uniform(4.0, 8.0), np.hypot(*(end - start)) - 3.0, 7.0)
    ]
    for door, room, _ in building.rooms[min(a, b), max(a, b)]:
        if random.random() < visited:
            stops.append((float((door - start) @ along), [door, room, door]))
    stops.sort(key=lambda stop: stop[0])
    points = [point for _, some in stops for point in some] + [end]
    return [Step("drive", (float(x), float(y))) for x, y in points]


def draw_wheels(random: np.random.Generator) -> tuple[str, OdometrySettings]:
    """Good wheels, wheels that turn the robot up to 2 degrees a metre, or wheels out of scale."""
    kind = str(random.choice(["good", "turns", "scale", "noise"]))
    imbalance, scale, noise = random.normal(0.0, 0.001), random.normal(0.0, 0.005), 0.003
    if kind == "turns":
        imbalance = random.uniform(0.003, 0.012) * random.choice([-1.0, 1.0])
    elif kind == "scale":
        scale = random.uniform(0.02, 0.06) * random.choice([-1.0, 1.0])
    elif kind == "noise":
        noise = random.uniform(0.01, 0.03)
    track = random.uniform(-0.1, 0.1)
    settings = OdometrySettings(
        radius_error=scale, imbalance=imbalance, track_error=track, noise=noise,
        slip_rate=random.choice([0.02, 0.1]), slip_size=0.01,
    )  # fmt: skip
    return kind, settings


def integrated(rolled: Array, track: float) -> Array:
    """(N, 3) poses by the wheels (N, 2), which are thought to be so far apart."""
    steps = np.diff(rolled, axis=0)
    forward, turned = steps.mean(axis=1), (steps[:, 1] - steps[:, 0]) / track
    yaw = np.cumsum(turned)
    middle = yaw - turned / 2.0
    moved = np.cumsum(forward * np.array([np.cos(middle), np.sin(middle)]), axis=1)
    return np.concatenate([np.zeros((1, 3)), np.column_stack([*moved, yaw])])


def odometry_lines(moments: Array, odometry: Array) -> list[tuple[float, str]]:
    """ODOM, ten times a second."""
    found = []
    for stamp, (x, y, yaw) in zip(moments[20:-20:2].tolist(), odometry[20:-20:2], strict=True):
        found.append((stamp, f"ODOM {x:.6f} {y:.6f} {wrap_angle(yaw):.6f} 0 0 0"))
    return found


def sweep(plan: Plan, drive: Drive, stamp: float) -> Array:
    """(180,) perfect ranges; a mirror that turns 75 times a second."""
    rays = drive.at(stamp + np.arange(180) / 360.0 / 75.0)
    rays[:, 2] += ANGLES
    return plan.cast(rays)[0]
