"""What really was: the trajectory, the grid a perfect laser draws, true loops, calibration."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mapmyworld.geometry.planar import between_planar, planar_to_matrix, wrap_angle
from mapmyworld.kernels.planar_rays import mark_passed_cells
from mapmyworld.simulation import robot
from mapmyworld.simulation.driver import TICK, Drive
from mapmyworld.simulation.floor_plan import Plan
from mapmyworld.simulation.robot_settings import SimulationSettings
from mapmyworld.simulation.world import Scene
from mapmyworld.types import Mesh, OccupancyGrid, Trajectory

_RESOLUTION = 0.05  # m, of the true grid
_LOG_ODDS = 4.0  # of a cell that is known for certain
_VIEW_SPACING = 0.5  # m between the places from which the perfect laser looks
_VIEW_BEAMS = 2880  # beams of the perfect laser, all around
_NODE_SPACING = 0.5  # m between the places that are compared for loops
_NODE_TURN = 0.5  # rad between them
_LOOP_DISTANCE = 1.0  # m within which two places are the same
_LOOP_ANGLE = 0.8  # rad within which the camera sees the same there
_LOOP_TIME = 20.0  # s that must lie between


@dataclass(frozen=True, slots=True, eq=False)
class LoopPairs:
    """Moments at which the robot was where it had been before, as parallel arrays."""

    stamps_ns: NDArray[np.int64]
    """(P, 2), earlier and later."""
    first_from_second: NDArray[np.float64]
    """(P, 3) x, y, yaw."""


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
        """As a perfect laser would map it from the robot's path; glass counts as a wall."""
        return _perfect_grid(self)

    @property
    def mesh(self) -> Mesh:
        """The world's surfaces."""
        return self.scene.mesh()

    @cached_property
    def loop_pairs(self) -> LoopPairs:
        """Moments at which the robot was back at a place."""
        return _true_loops(self)

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


def _perfect_grid(truth: Truth) -> OccupancyGrid:
    mount = robot.base_from_laser(truth.settings)[:2, 3]
    poses = truth.drive.poses[_spaced(truth.drive.poses, _VIEW_SPACING, np.inf)]
    cos, sin = np.cos(poses[:, 2]), np.sin(poses[:, 2])
    eyes = poses[:, :2] + np.stack(
        [cos * mount[0] - sin * mount[1], sin * mount[0] + cos * mount[1]], 1
    )
    low, shape = _lattice(truth.plan, eyes, truth.settings.laser.range_max)
    cells = np.full(shape, np.nan, np.float32)
    angles = 2.0 * np.pi * np.arange(_VIEW_BEAMS) / _VIEW_BEAMS
    struck = []
    for eye in eyes:
        rays = np.column_stack([np.broadcast_to(eye, (len(angles), 2)), angles])
        ranges, _ = truth.plan.cast(rays)
        reach = np.minimum(ranges, truth.settings.laser.range_max)
        mark_passed_cells(
            cells, (eye - low) / _RESOLUTION, angles, reach / _RESOLUTION - 0.5, -_LOG_ODDS
        )
        met = ranges <= truth.settings.laser.range_max
        way = np.stack([np.cos(angles[met]), np.sin(angles[met])], axis=1)
        # A hair's breadth inside what was met, so that a wall on a cell's edge is in that cell.
        struck.append(eye + way * (ranges[met, None] + 1e-4))
    index = np.floor((np.concatenate(struck) - low) / _RESOLUTION).astype(np.int64)
    inside = ((index >= 0) & (index < shape[::-1])).all(axis=1)
    cells[index[inside, 1], index[inside, 0]] = _LOG_ODDS
    return OccupancyGrid(cells, _RESOLUTION, low)


def _lattice(
    plan: Plan, eyes: NDArray[np.float64], range_max: float
) -> tuple[NDArray[np.float64], tuple[int, int]]:
    """Lower-left corner and shape that hold all that can be seen, on multiples of a cell."""
    ends = np.concatenate([plan.segments.reshape(-1, 2), eyes])
    low = np.maximum(ends.min(0), eyes.min(0) - range_max) - 2 * _RESOLUTION
    high = np.minimum(ends.max(0), eyes.max(0) + range_max) + 2 * _RESOLUTION
    low = np.floor(low / _RESOLUTION) * _RESOLUTION
    width, height = np.ceil((high - low) / _RESOLUTION).astype(np.int64)
    return low, (int(height), int(width))


def _spaced(poses: NDArray[np.float64], distance: float, turn: float) -> NDArray[np.int64]:
    """Indices of poses at least so far, or turned so much, from the one before."""
    kept = [0]
    for index in range(0, len(poses), 10):
        step = poses[index] - poses[kept[-1]]
        if np.hypot(step[0], step[1]) >= distance or abs(step[2]) >= turn:
            kept.append(index)
    return np.array(kept, np.int64)


def _true_loops(truth: Truth) -> LoopPairs:
    """Pairs of places, near and looking the same way, with nothing in between."""
    index = _spaced(truth.drive.poses, _NODE_SPACING, _NODE_TURN)
    poses = truth.drive.poses[index]
    times = index * TICK
    first, second = np.triu_indices(len(index), 1)
    near = np.hypot(*(poses[first, :2] - poses[second, :2]).T) < _LOOP_DISTANCE
    same = np.abs(wrap_angle(poses[first, 2] - poses[second, 2])) < _LOOP_ANGLE
    kept = near & same & (times[second] - times[first] >= _LOOP_TIME)
    first, second = first[kept], second[kept]
    clear = _in_sight(truth.plan, poses[first, :2], poses[second, :2])
    first, second = first[clear], second[clear]
    stamps = truth.start_ns + np.round(times * 1e9).astype(np.int64)
    return LoopPairs(
        np.stack([stamps[first], stamps[second]], axis=1),
        between_planar(poses[first], poses[second]),
    )


def _in_sight(plan: Plan, a: NDArray[np.float64], b: NDArray[np.float64]) -> NDArray[np.bool_]:
    way = b - a
    ranges, _ = plan.cast(np.column_stack([a, np.arctan2(way[:, 1], way[:, 0])]))
    return np.asarray(ranges > np.hypot(way[:, 0], way[:, 1]))


def true_trajectory(drive: Drive, stamps_ns: NDArray[np.int64], start_ns: int) -> Trajectory:
    """Poses at the stamps (N,), each once, in order."""
    stamps = np.unique(stamps_ns)
    return Trajectory(stamps, planar_to_matrix(drive.at((stamps - start_ns) * 1e-9)))
