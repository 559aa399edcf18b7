"""Numba kernels on tiled surface maps: matching, likelihoods and ray updates of many particles.

A map is a grid of cells, stored in tiles that particles share. A cell keeps how often beams ended
in it (`hits`) and crossed it or ended in it (`visits`), the mean end point within it and the mean
surface normal there. Each kernel treats particles one by one, so that any split of their range
over threads gives the same bytes.
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from mapmyworld.kernels.compiling import inner_jit, jit

TILE_SHIFT = 5
TILE = 1 << TILE_SHIFT  # cells a side
MASK = TILE - 1
MEMORY = 40  # hits after which a cell's mean forgets as fast as it learns
FULL = 255  # counts are halved when they reach this: old beliefs fade, and a byte is enough
OCCUPIED = 6  # a cell is a surface when at least one in so many visits was a hit
PLANAR = 0.6  # length of the mean normal from which end points count as a line


class Surfaces(NamedTuple):
    """The maps of all particles, as plain arrays."""

    tables: NDArray[np.int32]
    """(P, H, W) slot of every tile; 0 is the empty tile that all share."""
    hits: NDArray[np.uint8]
    """(S, TILE * TILE)."""
    visits: NDArray[np.uint8]
    """(S, TILE * TILE)."""
    means: NDArray[np.uint8]
    """(S, TILE * TILE, 2) mean end point, in 1/255 of the cell's side."""
    normals: NDArray[np.int8]
    """(S, TILE * TILE, 2) mean normal, in 1/127."""
    base: NDArray[np.int64]
    """(2,) index y, x of the tile at table position (0, 0)."""
    resolution: float
    """m, side of a cell."""


class Beams(NamedTuple):
    """One scan, ready to be matched."""

    points: NDArray[np.float64]
    """(N, 2) end points, base frame."""
    normals: NDArray[np.float64]
    """(N, 2) unit normals towards the lidar; zero where unknown."""
    origin: NDArray[np.float64]
    """(2,) the lidar, base frame."""


@inner_jit
def turned(cos: float, sin: float, v: NDArray[np.float64]) -> tuple[float, float]:
    """A vector (2,) turned by the angle of this cosine and sine."""
    return cos * v[0] - sin * v[1], sin * v[0] + cos * v[1]


@inner_jit
def moved(
    pose: NDArray[np.float64], cos: float, sin: float, v: NDArray[np.float64]
) -> tuple[float, float]:
    """A point (2,) of the frame at `pose` (3,), whose heading has this cosine and sine."""
    return pose[0] + cos * v[0] - sin * v[1], pose[1] + sin * v[0] + cos * v[1]


@inner_jit
def slot_of(maps: Any, particle: int, ix: int, iy: int) -> int:
    """The tile of a particle's map that holds a cell; 0, the empty one, outside."""
    ty = (iy >> TILE_SHIFT) - maps.base[0]
    tx = (ix >> TILE_SHIFT) - maps.base[1]
    if ty < 0 or tx < 0 or ty >= maps.tables.shape[1] or tx >= maps.tables.shape[2]:
        return 0
    return int(maps.tables[particle, ty, tx])


@jit
def nearest(
    maps: Any, particle: int, x: float, y: float, nx: float, ny: float, reach: int
) -> tuple[float, float, float, float, float]:
    """Squared distance to the nearest surface cell's mean, that mean and its normal.

    Cells whose normal faces away from the beam's are passed over: a wall has two sides.
    """
    res = maps.resolution
    cx, cy = math.floor(x / res), math.floor(y / res)
    best, qx, qy, mx, my = 1e9, 0.0, 0.0, 0.0, 0.0
    for ring in range(reach + 1):
        if ring > 1 and best <= ((ring - 1) * res) ** 2:
            break
        for dy in range(-ring, ring + 1):
            step = 1 if (dy == ring or dy == -ring) else 2 * ring
            for dx in range(-ring, ring + 1, max(step, 1)):
                ix, iy = cx + dx, cy + dy
                slot = slot_of(maps, particle, ix, iy)
                if slot == 0:
                    continue
                cell = ((iy & MASK) << TILE_SHIFT) | (ix & MASK)
                hits = maps.hits[slot, cell]
                if hits == 0 or hits * OCCUPIED < maps.visits[slot, cell]:
                    continue
                px = (ix + maps.means[slot, cell, 0] / 255.0) * res
                py = (iy + maps.means[slot, cell, 1] / 255.0) * res
                d2 = (px - x) ** 2 + (py - y) ** 2
                if d2 < best:
                    ux = maps.normals[slot, cell, 0] / 127.0
                    uy = maps.normals[slot, cell, 1] / 127.0
                    if nx * ux + ny * uy < -0.2:
                        continue
                    best, qx, qy, mx, my = d2, px, py, ux, uy
    return best, qx, qy, mx, my
