"""What really was: the trajectory, the grid a perfect laser draws, true loops, calibration."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mapmyworld.config import MappingConfig
from mapmyworld.geometry import Array
from mapmyworld.geometry.planar import (
    between_planar,
    compose_planar,
    planar_to_matrix,
    wrap_angle,
)
from mapmyworld.mapping.canvas import Canvas, beams_of
from mapmyworld.simulation import robot
from mapmyworld.simulation.driver import TICK, Drive
from mapmyworld.simulation.floor_plan import Plan
from mapmyworld.simulation.robot_settings import SimulationSettings
from mapmyworld.simulation.world import Scene
from mapmyworld.types import OccupancyGrid, Scan, Trajectory
from mapmyworld.types.maps import Relations

_RESOLUTION = 0.05  # m, of the true grid
_LOG_ODDS = 4.0  # of a cell that is known for certain
_HAIR = 1e-4  # m
_VIEW_SPACING = 0.5  # m between the places from which the perfect laser looks
_VIEW_BEAMS = 2880  # beams of the perfect laser, all around
_NODE_SPACING = 0.5  # m between the places that are compared for loops
_NODE_TURN = 0.5  # rad between them
_LOOP_DISTANCE = 1.0  # m within which two places are the same
_LOOP_ANGLE = 0.8  # rad within which the camera sees the same there
_LOOP_TIME = 20.0  # s that must lie between


@dataclass(frozen=True, eq=False)
class Truth:
    """Everything is in the world's frame, whose origin is the start of the default route."""

    trajectory: Trajectory
    """Pose of the robot's footprint at the stamp of every sensor's message."""
    drive: Drive
    plan: Plan
    scene: Scene
    settings: SimulationSettings
    start_ns: int

    @cached_property
    def grid(self) -> OccupancyGrid:
        """As a perfect laser would map it from the robot's path; glass counts as a wall.

        Cells that its beams ended in, and those that they only passed.
        """
        mount = robot.base_from_laser(self.settings)[:2, 3]
        poses = self.drive.poses[_spaced(self.drive.poses, _VIEW_SPACING, np.inf)]
        places = compose_planar(poses, [*mount, 0.0])
        places[:, 2] = 0.0
        settings = MappingConfig(
            resolution=_RESOLUTION,
            range_max=self.settings.laser.range_max,
            missing_range=self.settings.laser.range_max,
        )
        canvas = Canvas(places[:, :2] / _RESOLUTION, settings.range_max / _RESOLUTION)
        for place in places:
            canvas.add(beams_of([(place, _perfect_sweep(self, place))], settings))
        corner, seen = canvas.seen()
        hits, passes = np.moveaxis(seen, 2, 0)
        cells = np.where(passes > 0, np.float32(-_LOG_ODDS), np.float32(np.nan))
        cells[hits > 0] = _LOG_ODDS
        return OccupancyGrid(cells, _RESOLUTION, np.round(corner * _RESOLUTION, 9))

    @cached_property
    def loop_pairs(self) -> Relations:
        """Moments at which the robot was back at a place, looking the same way, in sight of it."""
        index = _spaced(self.drive.poses, _NODE_SPACING, _NODE_TURN)
        poses = self.drive.poses[index]
        times = index * TICK
        first, second = np.triu_indices(len(index), 1)
        near = np.hypot(*(poses[first, :2] - poses[second, :2]).T) < _LOOP_DISTANCE
        same = np.abs(wrap_angle(poses[first, 2] - poses[second, 2])) < _LOOP_ANGLE
        kept = near & same & (times[second] - times[first] >= _LOOP_TIME)
        first, second = first[kept], second[kept]
        way = poses[second, :2] - poses[first, :2]
        rays = np.column_stack([poses[first, :2], np.arctan2(way[:, 1], way[:, 0])])
        clear = self.plan.cast(rays)[0] > np.hypot(way[:, 0], way[:, 1])
        first, second = first[clear], second[clear]
        stamps = self.start_ns + np.round(times * 1e9).astype(np.int64)
        first_from_second = planar_to_matrix(between_planar(poses[first], poses[second]))
        return Relations(np.stack([stamps[first], stamps[second]], axis=1), first_from_second)

    @property
    def calibration(self) -> dict[str, Any]:
        """Mounting and intrinsics of the sensors, and the wheels' real sizes, for JSON."""
        s = self.settings
        true_radius = s.body.wheel_radius / (1.0 - s.odometry.radius_error)
        return {
            "base_frame": robot.BASE,
            "base_from_laser": robot.base_from_laser(s).tolist(),
            "base_from_camera_optical": robot.base_from_optical(s).tolist(),
            "camera_intrinsics": robot.intrinsics(s).tolist(),
            "camera_size": [s.camera.width, s.camera.height],
            "wheel_radius_believed": s.body.wheel_radius,
            "wheel_radius_true": true_radius,
            "wheel_track_believed": s.body.wheel_track * (1.0 + s.odometry.track_error),
            "wheel_track_true": s.body.wheel_track,
        }


def _perfect_sweep(truth: Truth, place: Array) -> Scan:
    """All round from a place (3,), in its frame."""
    angles = 2.0 * np.pi * np.arange(_VIEW_BEAMS) / _VIEW_BEAMS
    ranges, _ = truth.plan.cast(np.column_stack([np.tile(place[:2], (_VIEW_BEAMS, 1)), angles]))
    met = ranges <= truth.settings.laser.range_max
    along = np.stack([np.cos(angles[met]), np.sin(angles[met])], axis=1)
    # A hair's breadth inside what was met, so that a wall on a cell's edge is in that cell.
    points = along * (ranges[met, None] + _HAIR)
    return Scan(
        points.astype(np.float32), np.zeros(3), angles[~met].astype(np.float32),
        truth.settings.laser.range_max, 2.0 * np.pi / _VIEW_BEAMS,
    )  # fmt: skip


def _spaced(poses: Array, distance: float, turn: float) -> NDArray[np.int64]:
    """Indices of poses at least so far, or turned so much, from the one before."""
    kept = [0]
    for index in range(0, len(poses), 10):
        step = poses[index] - poses[kept[-1]]
        if np.hypot(step[0], step[1]) >= distance or abs(step[2]) >= turn:
            kept.append(index)
    return np.array(kept, np.int64)
