"""Quaternions that give a rotation matrix back bit by bit, where there are such."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from mapmyworld.geometry.rotations import rotation_to_quaternion

_STEPS = np.arange(-4, 5)  # units in the last place around the first guess


def exact_quaternion(rotation: NDArray[np.float64]) -> tuple[float, float, float, float]:
    """X y z w of a rotation (3, 3); for one about z, exactly what a reader turns back into it.

    A log that is written and read again must give the same map byte for byte, so the last bit of
    a pose matters. Readers form `1 - 2 z z / (z z + w w)` and `2 z w / (z z + w w)`; the pair
    (z, w) that was read once lies within a few units in the last place of the half angle's.
    """
    if rotation[2, 2] != 1.0 or rotation[0, 0] != rotation[1, 1]:
        x, y, z, w = rotation_to_quaternion(rotation).tolist()
        return x, y, z, w
    half = 0.5 * np.arctan2(rotation[1, 0], rotation[0, 0])
    z, w = np.sin(half), np.cos(half)
    zs, ws = np.meshgrid(z + _STEPS * np.spacing(z), w + _STEPS * np.spacing(w), indexing="ij")
    scale = 2.0 / (zs * zs + ws * ws)
    cosines, sines = 1.0 - scale * zs * zs, scale * ws * zs
    wrong = (cosines != rotation[0, 0]) * 1.0 + (sines != rotation[1, 0]) * 1.0
    distance = np.abs(_STEPS)[:, None] + np.abs(_STEPS)[None, :]
    best = np.unravel_index(np.argmin(wrong * 100 + distance), wrong.shape)
    return 0.0, 0.0, float(zs[best]), float(ws[best])
