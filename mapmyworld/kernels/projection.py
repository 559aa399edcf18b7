"""From rays to pixels by the formulas of OpenCV's camera models."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from mapmyworld.kernels.compiling import inner_jit, jit

Array = NDArray[np.float64]
STRAIGHT, PLUMB_BOB, EQUIDISTANT = 0, 1, 2


@inner_jit
def project(
    x: float, y: float, intrinsics: Array, bent: int, distortion: Array
) -> tuple[float, float]:
    """Pixel of normalised image coordinates, by intrinsics (3, 3).

    `distortion` (12,) is padded with zeros.
    """
    if bent == PLUMB_BOB:
        x, y = _plumb_bob(x, y, distortion)
    elif bent == EQUIDISTANT:
        x, y = _equidistant(x, y, distortion)
    u = x * intrinsics[0, 0] + intrinsics[0, 2]
    return u, y * intrinsics[1, 1] + intrinsics[1, 2]


@inner_jit
def _plumb_bob(x: float, y: float, d: Array) -> tuple[float, float]:
    """With the rational model's denominator and thin prisms, whose coefficients may be 0."""
    r2 = x * x + y * y
    radial = 1.0 + r2 * (d[0] + r2 * (d[1] + r2 * d[4]))
    radial /= 1.0 + r2 * (d[5] + r2 * (d[6] + r2 * d[7]))
    u = x * radial + 2.0 * d[2] * x * y + d[3] * (r2 + 2.0 * x * x) + r2 * (d[8] + r2 * d[9])
    v = y * radial + d[2] * (r2 + 2.0 * y * y) + 2.0 * d[3] * x * y + r2 * (d[10] + r2 * d[11])
    return u, v


@inner_jit
def _equidistant(x: float, y: float, d: Array) -> tuple[float, float]:
    r = np.sqrt(x * x + y * y)
    if r <= 1e-9:
        return x, y
    angle = np.arctan(r)
    squared = angle * angle
    scale = 1.0 + squared * (d[0] + squared * (d[1] + squared * (d[2] + squared * d[3])))
    return x * angle * scale / r, y * angle * scale / r


@jit
def project_points(
    points: Array, intrinsics: Array, bent: int, distortion: Array, pixels: Array
) -> None:
    """Fills `pixels` (N, 2) of points (N, 3) of the camera's frame, NaN at or behind its plane.

    `intrinsics` (3, 3) and `distortion` (12,) as of `project`.
    """
    for i in range(len(points)):
        z = points[i, 2]
        pixels[i] = np.nan
        if z > 1e-6:
            pixels[i, 0], pixels[i, 1] = project(
                points[i, 0] / z, points[i, 1] / z, intrinsics, bent, distortion
            )
