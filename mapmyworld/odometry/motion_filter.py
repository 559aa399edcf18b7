"""Where a camera is next, by its motion so far: a Kalman filter of pose and velocity.

Where images leave a direction degenerate (a distant wall, features in one corner), successive poses
would jump by as much as they leave open; inertia does not allow it.
"""

from __future__ import annotations

import numpy as np

from mapmyworld.geometry import Array
from mapmyworld.geometry.rigid import between, invert, se3_adjoint, se3_exp, se3_log
from mapmyworld.geometry.rotations import so3_exp, so3_log
from mapmyworld.types import Frame

_TRANSLATION_NOISE = 1.0  # m/s per root of a second, process noise of velocity
_ROTATION_NOISE = 3.0  # rad/s per root of a second, process noise of turning
_GYRO = 0.02  # rad/s by which a gyroscope may be off: its bias
_FADING = 0.3  # s in which the velocity of a blind camera falls to a third
_NIS_LIMIT = 22.5  # squared sigmas that one in a thousand measurements exceeds (6 dimensions)
FLOOR = 1e-6 * np.eye(6)
"""rad^2 and m^2: no motion between two frames is known better."""


class MotionFilter:
    """Pose and velocity of a base in the tracker's frame, with the covariance of both.

    Errors are tangents at the pose, rotation first; the velocity wanders as white acceleration
    lets it (Bar-Shalom, Li and Kirubarajan, "Estimation with applications to tracking and
    navigation", 2001, section 6.2).
    """

    def __init__(self) -> None:
        noise = [_ROTATION_NOISE, _TRANSLATION_NOISE]
        self._noise = np.diag(np.repeat(np.square(noise), 3))
        self.pose = np.eye(4)
        self._velocity = np.zeros(6)
        self._covariance = np.zeros((12, 12))
        self._covariance[6:, 6:] = self._noise  # a velocity may be what a second makes of it
        self.step_covariance = np.eye(6)
        """(6, 6) of the motion that was predicted last, images not counted."""
        self.slip = np.zeros(6)
        """By how much the pose moved last although the base did not: the map was mended."""

    def predict(self, seconds: float, turn: Array | None = None) -> Array:
        """The pose (4, 4) after so long, by the gyroscope's `turn` (3, 3) and constant velocity."""
        noise = self._noise
        step = se3_exp(self._velocity * seconds)
        moving = np.eye(12)
        moving[:6, 6:] = np.eye(6) * seconds
        added = np.kron([[seconds**3 / 3, seconds**2 / 2], [seconds**2 / 2, seconds]], noise)
        if turn is not None and seconds > 0.0:
            step = step.copy()
            step[:3, :3] = turn
            self._velocity[:3] = so3_log(turn) / seconds
            self._covariance[6:9] = self._covariance[:, 6:9] = 0.0
            self._covariance[6:9, 6:9] = np.eye(3) * _GYRO**2
            added[:3] = added[:, :3] = 0.0
        moving[:6, :6] = se3_adjoint(invert(step))
        own = moving[:6, 6:] @ self._covariance[6:, 6:] @ moving[:6, 6:].T
        self.step_covariance = own + added[:6, :6]
        self._covariance = moving @ self._covariance @ moving.T + added
        self.pose = self.pose @ step
        return self.pose

    def pose_covariance(self) -> Array:
        """(6, 6) of the pose, in the map that the camera is tracked in."""
        return self._covariance[:6, :6].copy()

    def correct(self, measured: Array, covariance: Array) -> Array:
        """The pose (4, 4) between what was predicted and what was `measured` (4, 4).

        This has a covariance (6, 6). A motion that nobody could expect (a jolt) is believed of the
        images.
        """
        off = se3_log(between(self.pose, measured))
        prior = self._covariance
        squared = float(off @ np.linalg.solve(prior[:6, :6] + covariance, off))
        self.slip = np.zeros(6)
        if squared > _NIS_LIMIT:
            self.slip = off
            prior = prior * (squared / _NIS_LIMIT)
        gain = np.linalg.solve(prior[:6, :6] + covariance, prior[:6]).T
        change = gain @ off
        prior = prior - gain @ prior[:6]
        self._covariance = 0.5 * (prior + prior.T)
        self.pose = self.pose @ se3_exp(change[:6])
        self._velocity = self._velocity + change[6:]
        return self.pose

    def coast(self, seconds: float) -> None:
        """A step without images was taken: nobody knows whether the camera still moves."""
        self._velocity = self._velocity * np.exp(-seconds / _FADING)

    def restart(self) -> None:
        """Where the camera is now defines a new map."""
        self._covariance[:6] = self._covariance[:, :6] = 0.0


def blind_variances(seconds: float, *, has_gyro: bool) -> Array:
    """(6,) of a motion that no image shows: its velocity wanders and fades.

    They grow with the time, at any rate of frames.
    """
    sigmas = _GYRO if has_gyro else _FADING * _ROTATION_NOISE, _FADING * _TRANSLATION_NOISE
    return np.asarray(np.repeat(np.square(sigmas) * seconds, 3) + FLOOR.diagonal())


def exceeds_nis(off: Array, covariance: Array) -> bool:
    """Whether an error (6,) of covariance (6, 6) is so large that one in a thousand is."""
    return float(off @ np.linalg.solve(covariance, off)) > _NIS_LIMIT


def covariance_of_base(information: Array, base_from_camera: Array) -> Array:
    """Covariance (6, 6) of the base's pose, by the camera's `information` (6, 6).

    Rotation first, never better than the floor; `base_from_camera` (4, 4).
    """
    adjoint = se3_adjoint(base_from_camera)
    covariance = np.linalg.inv(information + 1e-6 * np.eye(6))
    return np.asarray(adjoint @ covariance @ adjoint.T + 0.5 * FLOOR)


def motion_information(pose_covariance: Array, step_covariance: Array, slip: Array) -> Array:
    """(6, 6) of the motion between two poses, as images and inertia know it together.

    The former know each pose to `pose_covariance`, the latter the motion to `step_covariance`,
    (6, 6) both. By as much as the second slipped with the map, `slip` (6,), nobody knows it.
    """
    seen, carried = 2.0 * pose_covariance, step_covariance + FLOOR
    covariance = np.linalg.inv(np.linalg.inv(seen) + np.linalg.inv(carried))
    return np.asarray(np.linalg.inv(covariance + np.outer(slip, slip)))


def gyro_rotation(frame: Frame, since_ns: int) -> Array:
    """The rotation (3, 3) since then that the gyroscope integrated."""
    rotation, stamp = np.eye(3), since_ns
    for k, sample in enumerate(frame.imu):
        until = sample.stamp_ns if k + 1 < len(frame.imu) else frame.stamp_ns
        rotation = rotation @ so3_exp(sample.angular_velocity * max(until - stamp, 0) * 1e-9)
        stamp = max(until, stamp)
    return rotation
