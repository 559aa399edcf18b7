"""Motion taken from the log's own odometry, with an honest covariance.

The covariances in odometry messages are not taken: they say how far off the pose has come to be,
which late in a drive grows far faster than one step errs, or are a constant that ignores a
step.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from mapmyworld.geometry.rigid import between
from mapmyworld.geometry.rotations import so3_log

# Standard deviations of wheel odometry, after the motion model of Probabilistic Robotics,
# table 5.6: metres a metre, radians a metre, radians a radian, metres a radian.
_SLIP = 0.05
_YAW_BY_DISTANCE = 0.03
_YAW_BY_TURN = 0.05
_SLIP_BY_TURN = 0.02
_FLOOR = (1e-4, 5e-4)  # rad and m that even a standing robot is uncertain of
_FLAT = (1e-4, 1e-4)  # rad and m by which a planar robot leaves its plane


def motion_covariance(a_from_b: NDArray[np.float64], *, planar: bool) -> NDArray[np.float64]:
    """Covariance (6, 6), rotation first, of an odometry motion (4, 4), by a motion model."""
    distance = float(np.linalg.norm(a_from_b[:3, 3]))
    turn = float(np.linalg.norm(so3_log(a_from_b[:3, :3])))
    yaw = _FLOOR[0] + _YAW_BY_DISTANCE * distance + _YAW_BY_TURN * turn
    slip = _FLOOR[1] + _SLIP * distance + _SLIP_BY_TURN * turn
    sigmas = np.array([yaw, yaw, yaw, slip, slip, slip])
    if planar:
        sigmas[[0, 1]], sigmas[5] = _FLAT[0], _FLAT[1]
    return np.diag(sigmas**2)


class RecordedMotionModel:
    """The motion between successive odometry poses of a log, and how confident it is."""

    def __init__(self, *, planar: bool) -> None:
        self._planar = planar
        self._last: NDArray[np.float64] | None = None

    def follow(self, odom_from_base: NDArray[np.float64]) -> NDArray[np.float64]:
        """Covariance (6, 6), rotation first, of the motion to this pose (4, 4) from the last."""
        moved = np.eye(4) if self._last is None else between(self._last, odom_from_base)
        self._last = odom_from_base
        return motion_covariance(moved, planar=self._planar)
