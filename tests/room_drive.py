"""A robot with a laser and wheels that drives a circle in a box room; everything is known."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass, replace

import numpy as np
from messages_in_memory import odometry_at, scan_at, transform

from formats.recording_files import LogWriter
from mapmyworld.geometry.planar import compose_planar
from mapmyworld.types import LaserScanMessage, Message

START_NS = 1_700_000_000_000_000_000
STEP_NS = 100_000_000
ROOM = (6.0, 4.0)  # m, sides of the room, its corner at the origin
PILLARS = ((1.2, 0.9, 0.25), (2.8, 3.5, 0.3), (5.1, 0.7, 0.2))  # x, y, radius in m
MOUNT = (0.15, 0.0, 0.0)  # base_from_laser

Entry = tuple[str, Message, int]


@dataclass(frozen=True)
class Drive:
    """A log of the room, and where the robot really was at every scan."""

    entries: tuple[Entry, ...]
    truth: np.ndarray
    """(N, 3)."""

    def without(self, *topics: str) -> Drive:
        return replace(self, entries=tuple(e for e in self.entries if e[0] not in topics))

    def changed(self, topic: str, change: Callable[[Message], Message]) -> Drive:
        """The log with every message of a topic changed."""
        entries = ((t, change(m) if t == topic else m, time) for t, m, time in self.entries)
        return replace(self, entries=tuple(entries))

    def write(self, path: object) -> None:
        write(path, self.entries)


def write(path: object, entries: Iterable[Entry]) -> None:
    with LogWriter(path) as writer:  # type: ignore[arg-type]
        for topic, message, time in entries:
            writer.write(topic, message, time)


def drive(scans: int = 80, seed: int = 0) -> Drive:
    """A circle in the room, odometry that turns 3 % too much, 5 mm of noise in the ranges."""
    rng = np.random.default_rng(seed)
    angles = np.linspace(0.0, 2.0 * np.pi, scans)
    centre = np.array(ROOM) / 2
    truth = np.stack(
        [
            centre[0] + 1.2 * np.cos(angles),
            centre[1] + 0.8 * np.sin(angles),
            np.arctan2(0.8 * np.cos(angles), -1.2 * np.sin(angles)),
        ],
        axis=-1,
    )
    entries: list[Entry] = [("/tf_static", transform("base_link", "laser", MOUNT), START_NS)]
    odometry = np.zeros(3)
    for i, pose in enumerate(truth):
        time = START_NS + i * STEP_NS
        if i:
            odometry = compose_planar(odometry, _step(truth[i - 1], pose))
        entries.append(("/odom", odometry_at(time, odometry.tolist()), time))
        entries.append(("/scan", _sweep(pose, time, rng), time))
    return Drive(tuple(entries), truth)


def _step(before: np.ndarray, now: np.ndarray) -> np.ndarray:
    moved = compose_planar(
        [-(c := np.cos(before[2])) * before[0] - (s := np.sin(before[2])) * before[1],
         s * before[0] - c * before[1], -before[2]], now
    )  # fmt: skip
    return np.asarray(moved * [1.0, 1.0, 1.03])


def _sweep(pose: np.ndarray, stamp_ns: int, rng: np.random.Generator) -> LaserScanMessage:
    x, y, yaw = compose_planar(pose, MOUNT)
    bearings = yaw - np.pi / 2 + np.pi / 180 * np.arange(181)
    exact = ranges_in_room(x, y, bearings)
    return scan_at(stamp_ns, exact + rng.normal(0, 0.005, len(bearings)))


def ranges_in_room(x: float, y: float, bearings: np.ndarray) -> np.ndarray:
    """Distances (N,) to the walls and pillars, in closed form."""
    cos, sin = np.cos(bearings), np.sin(bearings)
    with np.errstate(divide="ignore"):
        to_x = np.where(cos > 0, (ROOM[0] - x) / cos, -x / cos)
        to_y = np.where(sin > 0, (ROOM[1] - y) / sin, -y / sin)
    nearest = np.minimum(to_x, to_y)
    for px, py, radius in PILLARS:
        along = (px - x) * cos + (py - y) * sin
        gap = radius**2 - ((px - x) ** 2 + (py - y) ** 2 - along**2)
        hit = (gap > 0) & (along > 0)
        nearest = np.where(hit, np.minimum(nearest, along - np.sqrt(np.maximum(gap, 0))), nearest)
    return np.asarray(nearest)
