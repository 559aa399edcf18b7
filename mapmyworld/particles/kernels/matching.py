"""Scan matching by Gauss-Newton, of many particles."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mapmyworld.kernels.compiling import inner_jit, jit
from mapmyworld.kernels.planar_algebra import solve3
from mapmyworld.particles.kernels.likelihood import log_likelihood
from mapmyworld.particles.kernels.surface_tiles import PLANAR, nearest, turned

STEP, TURN = 1e-3, 2e-4  # m, rad: steps that change no cell and end the search
POINT = 0.1  # weight of an end point at a cell that is no line: it may lie beside the true one
WIDE = 0.02  # weight of the prediction while the search is wide
COARSE = 0.08  # m, end points about surfaces where candidates are compared, half a step off


@jit
def linearise(
    maps: Any,
    particle: int,
    beams: Any,
    pose: NDArray[np.float64],
    reach: int,
    sigma: float,
    H: NDArray[np.float64],
    g: NDArray[np.float64],
) -> None:
    """Adds the scan's Gauss-Newton system at `pose` (3,) to H (3, 3), g (3,).

    Residuals run along the normal where the map has one, else in both axes. Increments are
    those of the map frame, the rotation about the robot.
    """
    cos, sin = math.cos(pose[2]), math.sin(pose[2])
    limit = ((reach + 0.5) * maps.resolution) ** 2
    inverse = 1.0 / (sigma * sigma)
    for i in range(beams.points.shape[0]):
        rx, ry = turned(cos, sin, beams.points[i])
        nx, ny = turned(cos, sin, beams.normals[i])
        x, y = pose[0] + rx, pose[1] + ry
        d2, qx, qy, mx, my = nearest(maps, particle, x, y, nx, ny, reach)
        if d2 > limit:
            continue
        ex, ey = x - qx, y - qy
        length = math.sqrt(mx * mx + my * my)
        if length > PLANAR:
            ux, uy = mx / length, my / length
            r = ux * ex + uy * ey
            w = inverse / (1.0 + r * r * inverse) ** 2
            jt = -ux * ry + uy * rx
            H[0, 0] += w * ux * ux
            H[0, 1] += w * ux * uy
            H[0, 2] += w * ux * jt
            H[1, 1] += w * uy * uy
            H[1, 2] += w * uy * jt
            H[2, 2] += w * jt * jt
            g[0] += w * ux * r
            g[1] += w * uy * r
            g[2] += w * jt * r
        else:
            w = POINT * inverse / (1.0 + d2 * inverse) ** 2
            H[0, 0] += w
            H[0, 2] += -w * ry
            H[1, 1] += w
            H[1, 2] += w * rx
            H[2, 2] += w * (rx * rx + ry * ry)
            g[0] += w * ex
            g[1] += w * ey
            g[2] += w * (-ry * ex + rx * ey)
    H[1, 0], H[2, 0], H[2, 1] = H[0, 1], H[0, 2], H[1, 2]


@inner_jit
def _deviation(
    pose: NDArray[np.float64],
    mean: NDArray[np.float64],
    P: NDArray[np.float64],
    gap: NDArray[np.float64],
) -> float:
    """Squared Mahalanobis distance of a pose from its prediction; `gap` becomes the difference."""
    for i in range(3):
        gap[i] = pose[i] - mean[i]
    gap[2] -= 2.0 * math.pi * math.floor((gap[2] + math.pi) / (2.0 * math.pi))
    total = 0.0
    for i in range(3):
        for j in range(3):
            total += gap[i] * P[i, j] * gap[j]
    return total


@inner_jit
def _likeliest(
    maps: Any,
    particle: int,
    beams: Any,
    mean: NDArray[np.float64],
    P: NDArray[np.float64],
    offsets: NDArray[np.float64],
    reach: int,
    pose: NDArray[np.float64],
) -> None:
    """Fills `pose` (3,) with the likeliest of the candidates `offsets` (S, 3) from the `mean`."""
    cos, sin = math.cos(mean[2]), math.sin(mean[2])
    start, gap = np.zeros(3), np.zeros(3)
    most = -1e18
    for k in range(offsets.shape[0]):
        ox, oy = turned(cos, sin, offsets[k])
        start[0], start[1], start[2] = mean[0] + ox, mean[1] + oy, mean[2] + offsets[k, 2]
        value = log_likelihood(maps, particle, beams, start, reach, COARSE)
        value -= 0.5 * _deviation(start, mean, P, gap)
        if value > most:
            most = value
            # Number by number: an assignment of slices takes seconds to compile.
            for i in range(3):
                pose[i] = start[i]


@jit
def match(
    maps: Any,
    first: int,
    last: int,
    beams: Any,
    predicted: NDArray[np.float64],
    prior: NDArray[np.float64],
    offsets: NDArray[np.float64],
    max_distances: NDArray[np.int64],
    sigma: float,
    poses: NDArray[np.float64],
    informations: NDArray[np.float64],
    fits: NDArray[np.float64],
) -> None:
    """Most likely poses of particles `first` to `last`, given their maps and predictions.

    `predicted` (P, 3) poses; `prior` (P, 3, 3) their information, in the map frame's axes.
    The search starts from the likeliest of the candidates that lie `offsets` (S, 3) from there.
    `max_distances` (R,): cells searched around an end point, for each iteration. Fills `poses`
    (P, 3), `informations` (P, 3, 3) and `fits` (P,): the log-likelihood of the scan, less half the
    squared deviation from the prediction.
    """
    H, g = np.zeros((3, 3)), np.zeros(3)
    gap, pose = np.zeros(3), np.zeros(3)
    for particle in range(first, last):
        mean, P = predicted[particle], prior[particle]
        _likeliest(maps, particle, beams, mean, P, offsets, max_distances[-1], pose)
        for iteration in range(max_distances.shape[0]):
            H[:], g[:] = 0.0, 0.0
            # From as far as the start may lie off down to the noise, for which the few marks of a
            # corridor would be outliers from the beginning.
            width = max(sigma, COARSE * 0.5**iteration)
            linearise(maps, particle, beams, pose, max_distances[iteration], width, H, g)
            _deviation(pose, mean, P, gap)
            weight = WIDE if max_distances[iteration] > max_distances[-1] else 1.0
            H += weight * P
            g += weight * (P[:, 0] * gap[0] + P[:, 1] * gap[1] + P[:, 2] * gap[2])
            step = solve3(H, g)
            pose -= step
            small = abs(step[0]) + abs(step[1]) < STEP and abs(step[2]) < TURN
            if small and max_distances[iteration] == max_distances[-1] and width == sigma:
                break
        for i in range(3):
            poses[particle, i] = pose[i]
            for j in range(3):
                informations[particle, i, j] = H[i, j]
        fit = log_likelihood(maps, particle, beams, pose, max_distances[-1], sigma)
        fits[particle] = fit - 0.5 * _deviation(pose, mean, P, gap)
