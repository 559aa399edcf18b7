"""How well scans fit maps: the likelihood field, and the beam model."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mapmyworld.kernels.compiling import inner_jit, jit
from mapmyworld.particles.kernels.surface_tiles import (
    MASK,
    PLANAR,
    TILE_SHIFT,
    moved,
    nearest,
    slot_of,
    turned,
)

FREE = math.log(0.1)  # of an end point far from all surfaces
UNSEEN = 0.5 * FREE  # where no beam ever was: neither for the pose nor against it


@inner_jit
def _is_seen(maps: Any, particle: int, x: float, y: float) -> bool:
    """Whether any beam ended in the cell of a point, or crossed it."""
    ix, iy = math.floor(x / maps.resolution), math.floor(y / maps.resolution)
    slot = slot_of(maps, particle, ix, iy)
    cell = ((iy & MASK) << TILE_SHIFT) | (ix & MASK)
    return bool(maps.visits[slot, cell] > 0)


@jit
def log_likelihood(
    maps: Any, particle: int, beams: Any, pose: NDArray[np.float64], reach: int, sigma: float
) -> float:
    """Logarithm of p(z | x, m) of the likelihood field, for a pose (3,).

    Every beam ends near a surface, or by chance (Thrun et al. 2005, section 6.4). An end point
    where nothing was ever seen counts half as much against the pose as one in the open.
    """
    cos, sin = math.cos(pose[2]), math.sin(pose[2])
    total = 0.0
    half = 0.5 / (sigma * sigma)
    for i in range(beams.points.shape[0]):
        x, y = moved(pose, cos, sin, beams.points[i])
        nx, ny = turned(cos, sin, beams.normals[i])
        d2, qx, qy, mx, my = nearest(maps, particle, x, y, nx, ny, reach)
        if d2 < 1e8:
            length = math.sqrt(mx * mx + my * my)
            if length > PLANAR:
                along = (mx * (x - qx) + my * (y - qy)) / length
                d2 = 0.25 * d2 + 0.75 * along * along
            total += math.log(0.9 * math.exp(-half * d2) + 0.1)
        elif _is_seen(maps, particle, x, y):
            total += FREE
        else:
            total += UNSEEN
    return total


@jit
def beam_log_likelihoods(
    maps: Any,
    first: int,
    last: int,
    beams: Any,
    poses: NDArray[np.float64],
    sigma: float,
    out: NDArray[np.float64],
) -> None:
    """Fills `out` (P,), log p(z | x, m) at `poses` (P, 3): rays followed to the first surface.

    The beam model of Thrun et al. 2005, table 6.1, with a Gaussian about the expected range, a
    constant for what stands in the way and for chance, and no opinion where the ray leaves the
    known map.
    """
    half = 0.5 / (sigma * sigma)
    for particle in range(first, last):
        pose = poses[particle]
        cos, sin = math.cos(pose[2]), math.sin(pose[2])
        ox, oy = moved(pose, cos, sin, beams.origin)
        total = 0.0
        for i in range(beams.points.shape[0]):
            x, y = moved(pose, cos, sin, beams.points[i])
            error = _ray_error(maps, particle, ox, oy, x, y, 4.0 * sigma)
            total += math.log(0.9 * math.exp(-half * error * error) + 0.1)
        out[particle] = total


@inner_jit
def _ray_error(
    maps: Any, particle: int, ox: float, oy: float, x: float, y: float, beyond: float
) -> float:
    """Expected minus measured range, at most `beyond`, along the ray from o through (x, y)."""
    length = math.hypot(x - ox, y - oy)
    if length < 1e-6:
        return beyond
    ux, uy = (x - ox) / length, (y - oy) / length
    step = 0.5 * maps.resolution
    travelled = step
    while travelled < length + beyond:
        ix = math.floor((ox + ux * travelled) / maps.resolution)
        iy = math.floor((oy + uy * travelled) / maps.resolution)
        slot = slot_of(maps, particle, ix, iy)
        cell = ((iy & MASK) << TILE_SHIFT) | (ix & MASK)
        hits = maps.hits[slot, cell]
        if hits > 0 and hits * 2 >= maps.visits[slot, cell]:
            px = (ix + maps.means[slot, cell, 0] / 255.0) * maps.resolution
            py = (iy + maps.means[slot, cell, 1] / 255.0) * maps.resolution
            expected = (px - ox) * ux + (py - oy) * uy
            return float(max(-beyond, min(beyond, expected - length)))
        travelled += step
    return beyond
