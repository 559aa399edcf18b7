"""How well scans fit maps: the likelihood field."""

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
def surface_distances(
    maps: Any, particle: int, beams: Any, pose: NDArray[np.float64], reach: int
) -> NDArray[np.float64]:
    """Distances (L,), m, of end points from the lines next to them, for a pose (3,)."""
    cos, sin = math.cos(pose[2]), math.sin(pose[2])
    out, count = np.zeros(beams.points.shape[0]), 0
    for i in range(beams.points.shape[0]):
        x, y = moved(pose, cos, sin, beams.points[i])
        nx, ny = turned(cos, sin, beams.normals[i])
        d2, qx, qy, mx, my = nearest(maps, particle, x, y, nx, ny, reach)
        length = math.sqrt(mx * mx + my * my)
        if d2 < 1e8 and length > PLANAR:
            out[count] = abs(mx * (x - qx) + my * (y - qy)) / length
            count += 1
    return out[:count]
