"""The robot's messages, stream by stream: what each sensor sends at each of its moments."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from mapmyworld.geometry import Array
from mapmyworld.geometry.planar import planar_to_matrix
from mapmyworld.simulation import robot
from mapmyworld.simulation.clocks import Schedule, random_of
from mapmyworld.simulation.driver import TICK, Drive
from mapmyworld.simulation.robot_settings import SimulationSettings
from mapmyworld.simulation.simulated_laser import Laser, disturb_sweep
from mapmyworld.simulation.wheel_odometry import WheelOdometry
from mapmyworld.types import (
    ImuMessage,
    LaserScanMessage,
    Message,
    OdometryMessage,
    TextMessage,
    TransformsMessage,
    TransformStamped,
)

SCAN_TOPIC = "/graph_slam_bot/laser/scan"
ODOMETRY_TOPIC, IMU_TOPIC = "/odom", "/imu"
TF_TOPIC, STATIC_TOPIC, ROBOT_TOPIC = "/tf", "/tf_static", "/robot_description"

Messages = list[tuple[str, Message]]
_OFF_PLANE = 1e-6  # m^2 and rad^2: how firmly the robot stays on its floor
_GRAVITY = 9.81  # m/s^2
_SPAN = 0.02  # s over which accelerations are taken


@dataclass(frozen=True, slots=True, eq=False)
class Stream:
    """One sensor's moments, and how to make the messages of each."""

    topics: tuple[str, ...]
    schedule: Schedule
    messages: Callable[[int], Messages]


def static_messages(settings: SimulationSettings, stamp_ns: int) -> Messages:
    """What is latched: the mounting of everything, and the robot's description."""
    parts = [
        TransformStamped(stamp_ns, parent, child, pose)
        for parent, child, pose in robot.static_transforms(settings)
    ]
    return [
        (STATIC_TOPIC, TransformsMessage(tuple(parts), static=True)),
        (ROBOT_TOPIC, TextMessage(stamp_ns, robot.urdf(settings))),
    ]


def laser_stream(laser: Laser, drive: Drive, schedule: Schedule, seed: int) -> Stream:
    """The laser's sweeps."""

    def messages(index: int) -> Messages:
        s = laser.settings
        sweep = laser.sweep(drive, float(schedule.times[index]))
        ranges = disturb_sweep(sweep, s, random_of(seed, "laser", index))
        message = LaserScanMessage(
            stamp_ns=int(schedule.stamps_ns[index]),
            frame_id=robot.LASER,
            angle_min=float(laser.angles()[0]),
            angle_increment=laser.angle_increment,
            time_increment=laser.time_increment,
            scan_time=1.0 / s.rate,
            range_min=s.range_min,
            range_max=s.range_max,
            ranges=ranges,
            intensities=np.zeros(0, np.float32),
        )
        return [(SCAN_TOPIC, message)]

    return Stream((SCAN_TOPIC,), schedule, messages)


def odometry_stream(
    odometry: WheelOdometry, schedule: Schedule, settings: SimulationSettings
) -> Stream:
    """The wheels' odometry, and the same with the wheels' turns on tf."""

    def messages(index: int) -> Messages:
        stamp_ns = int(schedule.stamps_ns[index])
        pose = planar_to_matrix(odometry.poses[index])
        message = OdometryMessage(
            stamp_ns=stamp_ns,
            frame_id=robot.ODOM,
            child_frame_id=robot.BASE,
            pose=pose,
            pose_covariance=_spatial(odometry.covariances[index], (0, 1, 5)),
            twist=np.array([odometry.twists[index, 0], 0, 0, 0, 0, odometry.twists[index, 1]]),
            twist_covariance=_spatial(odometry.twist_covariances[index], (0, 5)),
        )
        moving = [TransformStamped(stamp_ns, robot.ODOM, robot.BASE, pose)]
        for side, angle in zip(
            (robot.LEFT_WHEEL, robot.RIGHT_WHEEL), odometry.wheels[index], strict=True
        ):
            wheel = robot.chassis_from_wheel(settings, side, float(angle))
            moving.append(TransformStamped(stamp_ns, robot.CHASSIS, side, wheel))
        return [
            (ODOMETRY_TOPIC, message),
            (TF_TOPIC, TransformsMessage(tuple(moving), static=False)),
        ]

    return Stream((ODOMETRY_TOPIC, TF_TOPIC), schedule, messages)


def imu_stream(drive: Drive, schedule: Schedule, settings: SimulationSettings, seed: int) -> Stream:
    """The inertial unit's samples, with gravity and a constant error of the gyroscope."""
    s = settings.imu
    bias = random_of(seed, "imu bias").normal(size=3) * s.gyro_bias
    rates, forward = _inertial(drive, schedule.times)
    noise = random_of(seed, "imu").normal(size=(len(schedule.times), 6))

    def messages(index: int) -> Messages:
        # Turning at speed pushes the robot sideways: the centripetal acceleration.
        force = np.array([forward[index, 1], forward[index, 0] * rates[index], _GRAVITY])
        message = ImuMessage(
            stamp_ns=int(schedule.stamps_ns[index]),
            frame_id=robot.CHASSIS,
            orientation=None,
            angular_velocity=np.array([0.0, 0.0, rates[index]])
            + bias
            + noise[index, :3] * s.gyro_noise,
            linear_acceleration=force + noise[index, 3:] * s.acceleration_noise,
        )
        return [(IMU_TOPIC, message)]

    return Stream((IMU_TOPIC,), schedule, messages)


def _inertial(drive: Drive, times: Array) -> tuple[Array, Array]:
    """Turn rates (N,), and (N, 2) forward speed and acceleration, at the times."""
    place = np.clip(times / TICK, 0, len(drive.speeds) - 1).astype(np.int64)
    before = np.clip(place - round(_SPAN / TICK / 2), 0, len(drive.speeds) - 1)
    after = np.clip(place + round(_SPAN / TICK / 2), 0, len(drive.speeds) - 1)
    speeds = drive.speeds[:, 0]
    gain = (speeds[after] - speeds[before]) / np.maximum((after - before) * TICK, TICK)
    return drive.speeds[place, 1], np.stack([speeds[place], gain], axis=1)


def _spatial(covariance: Array, rows: tuple[int, ...]) -> Array:
    """(6, 6) in ROS order of one over fewer directions; the others are known to be zero."""
    full = np.eye(6) * _OFF_PLANE
    full[np.ix_(rows, rows)] = covariance
    return full
