"""Where a log's odometry shows that its laser sits, if that is not where the log says."""

from __future__ import annotations

import numpy as np

from mapmyworld.geometry import Array
from mapmyworld.kernels.wheel_model import CERTAINTY, ERRORS, MOUNT

_WORTH_A_WORD = np.array([np.radians(1.0), 0.05, 0.05])  # rad, m and m by which a mount may be off
_SURE = 5.0  # sigmas


def notes(wheels: Array) -> tuple[str, ...]:
    """One line where a model (56,) of the odometry is sure that the laser sits elsewhere."""
    off, sigmas = wheels[MOUNT], np.sqrt(np.diag(wheels[CERTAINTY].reshape(ERRORS, ERRORS)))[1:4]
    if (np.abs(off) <= np.maximum(_WORTH_A_WORD, _SURE * sigmas)).all():
        return ()
    turned, ahead, aside = np.degrees(off[0]), off[1], off[2]
    return (
        f"the laser moves as if it sat {ahead:+.2f} m ahead and {aside:+.2f} m to the left of "
        f"where the log says, turned by {turned:+.1f} deg: check its mount in tf, or set "
        "sensing.scan_mount",
    )
