"""Wheel odometry: what encoders on imperfect wheels make of the true motion."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from mapmyworld.geometry import Array
from mapmyworld.simulation.driver import Drive
from mapmyworld.simulation.robot_settings import BodySettings, OdometrySettings

_STILL = 1e-6  # m of wheel travel below which neither noise nor slip occurs
_FLOOR = 1e-9  # m^2 and rad^2 of variance, so that a covariance can always be inverted


@dataclass(frozen=True, slots=True, eq=False)
class WheelOdometry:
    """Poses integrated from encoders, with the covariance of what they cannot know."""

    poses: Array
    """(N, 3) odom_from_base."""
    covariances: Array
    """(N, 3, 3) of x, y, yaw in the odometry's frame."""
    twists: Array
    """(N, 2) m/s forward and rad/s."""
    twist_covariances: Array
    """(N, 2, 2)."""
    wheels: Array
    """(N, 2) rad that the left and the right wheel have turned, by their encoders."""


def wheel_travel(drive: Drive, times: Array, body: BodySettings) -> Array:
    """(N, 2) m that the left and the right wheel really rolled until the `times` (N,), s."""
    forward, turned = np.moveaxis(drive.travel(times), -1, 0)
    half = body.wheel_track / 2.0
    return np.stack([forward - half * turned, forward + half * turned], axis=-1)


def disturb_wheels(
    travel: Array, times: Array, settings: OdometrySettings, random: np.random.Generator
) -> Array:
    """The travel that encoders report of the true one: wrong radii, random errors and slips.

    (N, 2) both, m by wheel at `times` (N,), s.
    """
    steps = np.diff(travel, axis=0)
    moving = np.abs(steps) > _STILL
    noise = random.normal(size=steps.shape) * settings.noise * np.sqrt(np.abs(steps))
    slips = random.random(steps.shape) < settings.slip_rate * np.diff(times)[:, None]
    # A slipping wheel turns farther than it rolls.
    lost = np.abs(random.normal(size=steps.shape)) * settings.slip_size * np.sign(steps)
    radius = 1.0 - settings.radius_error + np.array([0.5, -0.5]) * settings.imbalance
    reported = steps * radius + np.where(moving, noise, 0.0) + np.where(slips & moving, lost, 0.0)
    return np.concatenate([np.zeros((1, 2)), np.cumsum(reported, axis=0)])


def integrate_wheels(
    travel: Array, times: Array, settings: OdometrySettings, body: BodySettings
) -> WheelOdometry:
    """Poses from reported wheel `travel` (N, 2), with a track that is not quite the true one.

    At `times` (N,). The covariance propagates the random errors and, as constants that are unknown
    from the start, the errors of both radii and of the track (Thrun, Burgard, Fox, "Probabilistic
    Robotics", 2005, section 7.4, with the constants appended to the state).
    """
    track = body.wheel_track * (1.0 + settings.track_error)
    steps = np.diff(travel, axis=0)
    forward, turned = steps.mean(1), (steps[:, 1] - steps[:, 0]) / track
    yaw = np.concatenate([[0.0], np.cumsum(turned)])
    middle = yaw[:-1] + turned / 2.0
    x = np.concatenate([[0.0], np.cumsum(forward * np.cos(middle))])
    y = np.concatenate([[0.0], np.cumsum(forward * np.sin(middle))])
    spans = np.maximum(np.diff(times), 1e-6)
    # m^2 of each wheel's step (N, 2): random errors, and slips by their rate.
    slips = settings.slip_rate * spans[:, None] * settings.slip_size**2
    random = settings.noise**2 * np.abs(steps)
    variances = np.where(np.abs(steps) > _STILL, random + slips, 0.0)
    speeds = np.stack([forward, turned], axis=1) / spans[:, None]
    mixing = np.array([[0.5, 0.5], [-1.0 / track, 1.0 / track]])
    measured = np.einsum("ik,nk,jk->nij", mixing, variances, mixing) / spans[:, None, None] ** 2
    return WheelOdometry(
        poses=np.stack([x, y, yaw], axis=1),
        covariances=_pose_covariances(steps, middle, variances, track, settings),
        twists=np.concatenate([np.zeros((1, 2)), speeds]),
        twist_covariances=np.concatenate([measured[:1], measured]) + _FLOOR * np.eye(2),
        wheels=travel / body.wheel_radius,
    )


def _pose_covariances(
    steps: Array, headings: Array, variances: Array, track: float, settings: OdometrySettings
) -> Array:
    """(N + 1, 3, 3) of x, y, yaw; the state is followed by both radii's and the track's error."""
    radius = settings.radius_error**2
    side = (0.5 * settings.imbalance) ** 2
    state = np.zeros((6, 6))
    state[3:5, 3:5] = [[radius + side, radius - side], [radius - side, radius + side]]
    state[5, 5] = settings.track_error**2
    found = [np.zeros((3, 3))]
    move, gain = np.eye(6), np.zeros((6, 2))
    for (left, right), heading, variance in zip(steps, headings, variances, strict=True):
        cos, sin = np.cos(heading), np.sin(heading)
        forward, turned = (left + right) / 2.0, (right - left) / track
        gain[0] = [cos / 2.0 + forward * sin / 2.0 / track, cos / 2.0 - forward * sin / 2.0 / track]
        gain[1] = [sin / 2.0 - forward * cos / 2.0 / track, sin / 2.0 + forward * cos / 2.0 / track]
        gain[2] = [-1.0 / track, 1.0 / track]
        move[0, 2], move[1, 2] = -forward * sin, forward * cos
        move[:3, 3], move[:3, 4] = gain[:3, 0] * left, gain[:3, 1] * right
        move[:3, 5] = [forward * sin * turned / 2.0, -forward * cos * turned / 2.0, -turned]
        state = move @ state @ move.T + (gain * variance) @ gain.T
        found.append(state[:3, :3].copy())
    return np.array(found) + _FLOOR * np.eye(3)
