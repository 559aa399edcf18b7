"""A person at the keyboard: drives a differential-drive robot along a route."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import ArrayLike

from mapmyworld.errors import WorldError
from mapmyworld.geometry import Array
from mapmyworld.geometry.planar import interpolate_planar
from mapmyworld.simulation.robot_settings import DriverSettings
from mapmyworld.simulation.route import Step

TICK = 0.005  # s between poses of a drive
_ARRIVED = 0.12  # m from a place at which the driver turns to the next
_PASSED = 0.6  # m within which a place counts as reached once it lies behind
_ON_THE_SPOT = 0.6  # rad off course beyond which the driver stops to turn
_LOOK_AHEAD = 1.5  # m along the straight way at which the driver aims
_KEYS = np.array([-1.0, -0.5, -0.2, 0.0, 0.2, 0.5, 1.0])  # shares of the turn rate
_GIVE_UP = 120.0  # s after which a place counts as out of reach


@dataclass(frozen=True, slots=True, eq=False)
class Drive:
    """The true motion: poses every `TICK` seconds from zero on."""

    poses: Array
    """(N, 3) x, y, yaw of the robot's footprint in the world."""
    speeds: Array
    """(N, 2) forward m/s and turning rad/s, from each pose to the next."""
    jumps: tuple[int, ...]
    """Indices of the first poses after a kidnapping."""

    @property
    def duration(self) -> float:
        """Seconds."""
        return (len(self.poses) - 1) * TICK

    @property
    def length(self) -> float:
        """Metres driven, forwards and backwards."""
        return float(np.abs(self.speeds[:, 0]).sum() * TICK)

    def at(self, seconds: ArrayLike) -> Array:
        """Poses (..., 3) at the times (...,); the end poses beyond the ends."""
        place = np.clip(np.asarray(seconds) / TICK, 0.0, len(self.poses) - 1)
        low = np.minimum(place.astype(np.int64), len(self.poses) - 2)
        moved = interpolate_planar(self.poses[low], self.poses[low + 1], place - low)
        # Just before a kidnapping the robot is where it was, not half way.
        jumping = np.isin(low + 1, self.jumps) & (place - low < 1.0)
        return np.where(jumping[..., None], self.poses[low], moved)

    def travel(self, seconds: ArrayLike) -> Array:
        """(..., 2) metres forwards and radians turned since the start until `seconds` (...)."""
        sums = np.concatenate([np.zeros((1, 2)), np.cumsum(self.speeds[:-1] * TICK, axis=0)])
        place = np.clip(np.asarray(seconds) / TICK, 0.0, len(self.poses) - 1)
        knots = np.arange(len(self.poses), dtype=np.float64)
        return np.stack([np.interp(place, knots, sums[:, k]) for k in (0, 1)], axis=-1)


@dataclass(slots=True)
class _Robot:
    settings: DriverSettings
    pose: tuple[float, float, float]
    speed: float = 0.0
    turn: float = 0.0
    poses: list[tuple[float, float, float]] = field(default_factory=list)
    speeds: list[tuple[float, float]] = field(default_factory=list)
    jumps: list[int] = field(default_factory=list)

    def hold(self, speed: float, turn: float, seconds: float) -> None:
        """Keys held for a while: the wheels follow as fast as the robot's limits allow."""
        s = self.settings
        gain, swing = s.acceleration * TICK, s.turn_acceleration * TICK
        x, y, yaw = self.pose
        for _ in range(max(1, round(seconds / TICK))):
            self.speed += min(max(speed - self.speed, -gain), gain)
            self.turn += min(max(turn - self.turn, -swing), swing)
            self.poses.append((x, y, yaw))
            self.speeds.append((self.speed, self.turn))
            middle = yaw + self.turn * TICK / 2.0
            x += self.speed * TICK * math.cos(middle)
            y += self.speed * TICK * math.sin(middle)
            yaw += self.turn * TICK
        self.pose = (x, y, yaw)

    def stop(self) -> None:
        while abs(self.speed) > 1e-9 or abs(self.turn) > 1e-9:
            self.hold(0.0, 0.0, TICK)


def drive_route(steps: Sequence[Step], settings: DriverSettings) -> Drive:
    """The motion along a route; raises `WorldError` where a place cannot be reached."""
    x, y, yaw_deg = steps[0].values
    robot = _Robot(settings, (x, y, math.radians(yaw_deg)))
    robot.hold(0.0, 0.0, settings.pause)
    for step in steps[1:]:
        if step.kind in {"drive", "back"}:
            _go(robot, np.array(step.values), backwards=step.kind == "back")
        elif step.kind == "turn":
            robot.stop()
            _face(robot, robot.pose[2] + math.radians(step.values[0]))
        elif step.kind == "wait":
            robot.stop()
            robot.hold(0.0, 0.0, step.values[0])
        else:
            robot.stop()
            x, y, yaw_deg = step.values
            robot.pose = (x, y, math.radians(yaw_deg))
            robot.jumps.append(len(robot.poses))
    robot.stop()
    robot.hold(0.0, 0.0, settings.pause)
    return Drive(np.array(robot.poses), np.array(robot.speeds), tuple(robot.jumps))


def _go(robot: _Robot, place: Array, *, backwards: bool) -> None:
    s = robot.settings
    began, start = len(robot.poses), np.array(robot.pose[:2])
    limit_s = _GIVE_UP + float(np.hypot(*(place - start))) / s.speed
    while True:
        path = place - np.array(robot.pose[:2])
        distance = float(np.hypot(*path))
        aim = _carrot(start, place, np.array(robot.pose[:2])) - np.array(robot.pose[:2])
        course = np.arctan2(aim[1], aim[0]) + (np.pi if backwards else 0.0)
        off = float(np.remainder(course - robot.pose[2] + np.pi, 2.0 * np.pi) - np.pi)
        if distance < _ARRIVED or (distance < _PASSED and abs(off) > np.pi / 2.0):
            return
        if (len(robot.poses) - began) * TICK > limit_s:
            raise WorldError(f"the driver cannot reach {place[0]:g},{place[1]:g}")
        if abs(off) > _ON_THE_SPOT:
            robot.stop()
            _face(robot, robot.pose[2] + off)
            continue
        wanted = np.clip(1.5 * off, -s.turn_rate, s.turn_rate) / s.turn_rate
        key = _KEYS[np.argmin(np.abs(_KEYS - wanted))] * s.turn_rate
        speed = s.speed * (-1.0 if backwards else 1.0) * (0.6 if distance < 0.4 else 1.0)
        robot.hold(speed, float(key), 1.0 / s.decision_rate)


def _carrot(start: Array, place: Array, here: Array) -> Array:
    """The point of the straight way that lies `_LOOK_AHEAD` beyond the nearest one."""
    path = place - start
    length = float(np.hypot(*path))
    if length < 1e-9:
        return place
    along = float((here - start) @ path) / length + _LOOK_AHEAD
    return np.asarray(start + path * min(along / length, 1.0))


def _face(robot: _Robot, yaw: float) -> None:
    """Turns on the spot until the robot looks along `yaw`."""
    s = robot.settings
    while True:
        left = yaw - robot.pose[2]
        if abs(left) < 0.05:
            break
        braking = robot.turn**2 / (2.0 * s.turn_acceleration)
        rate = s.turn_rate if abs(left) > braking + 0.1 else 0.25 * s.turn_rate
        robot.hold(0.0, float(np.sign(left)) * rate, 4 * TICK)
    robot.stop()
