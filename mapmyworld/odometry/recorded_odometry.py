"""Motion taken from the log's own odometry, with an honest covariance.

The covariances in odometry messages are not taken: they say how far off the pose has come to be,
which late in a drive grows far faster than one step errs, or are a constant that ignores a
step.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from mapmyworld.geometry.rotations import so3_log
from mapmyworld.kernels.laser_motion import motion_variances

_NOISE = 0.05  # m per m and rad per rad, of wheels that nobody checks
_FLOOR = 5e-4  # m, and half as many rad, that even a standing robot is uncertain of


def motion_covariance(a_from_b: NDArray[np.float64], *, planar: bool) -> NDArray[np.float64]:
    """Covariance (6, 6), rotation first, of an odometry motion (4, 4), by a motion model.

    That of `motion_variances`; a planar robot leaves its plane by no more than the floor.
    """
    distance = float(np.linalg.norm(a_from_b[:3, 3]))
    turn = float(np.linalg.norm(so3_log(a_from_b[:3, :3])))
    step = np.array([distance, 0.0, turn])
    slip, _, yaw = motion_variances(step, _NOISE, _FLOOR).tolist()
    variances = np.array([yaw, yaw, yaw, slip, slip, slip])
    if planar:
        variances[[0, 1, 5]] = _FLOOR**2
    return np.diag(variances)
