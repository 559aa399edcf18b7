"""Scans written into the maps of particles."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mapmyworld.kernels.compiling import inner_jit, jit
from mapmyworld.kernels.rays import onward, ray_of
from mapmyworld.particles.kernels.surface_tiles import (
    FULL,
    MASK,
    MEMORY,
    TILE_SHIFT,
    moved,
    slot_of,
    turned,
)


@inner_jit
def _visit(maps: Any, slot: int, cell: int) -> None:
    if maps.visits[slot, cell] == FULL:
        maps.visits[slot, cell] = FULL >> 1
        maps.hits[slot, cell] >>= 1
    maps.visits[slot, cell] += 1


@inner_jit
def _cross(
    maps: Any, particle: int, ox: float, oy: float, x: float, y: float, own: NDArray[np.int32]
) -> None:
    """One more visit for the cells a beam crosses, up to a cell and a half before its end."""
    res = maps.resolution
    length = math.hypot(x - ox, y - oy)
    if length < 3.0 * res:
        return
    keep = (length - 1.5 * res) / length
    ray = ray_of(ox / res, oy / res, (ox + keep * (x - ox)) / res, (oy + keep * (y - oy)) / res)
    for _ in range(ray[8] + 1):
        ix, iy = ray[0], ray[1]
        slot = slot_of(maps, particle, ix, iy)
        if own[slot] == 1:
            _visit(maps, slot, ((iy & MASK) << TILE_SHIFT) | (ix & MASK))
        ray = onward(ray)


@inner_jit
def _hit(
    maps: Any,
    particle: int,
    x: float,
    y: float,
    nx: float,
    ny: float,
    own: NDArray[np.int32],
) -> None:
    """One more end point for a cell: counts, running mean and running normal."""
    res = maps.resolution
    ix, iy = math.floor(x / res), math.floor(y / res)
    slot = slot_of(maps, particle, ix, iy)
    if slot == 0 or own[slot] != 1:
        return
    cell = ((iy & MASK) << TILE_SHIFT) | (ix & MASK)
    _visit(maps, slot, cell)
    maps.hits[slot, cell] += 1
    rate = 1.0 / min(float(maps.hits[slot, cell]), float(MEMORY))
    fx, fy = (x / res - ix) * 255.0, (y / res - iy) * 255.0
    mean, normal = maps.means[slot, cell], maps.normals[slot, cell]
    mean[0] = round(mean[0] + rate * (fx - mean[0]))
    mean[1] = round(mean[1] + rate * (fy - mean[1]))
    normal[0] = round(normal[0] + rate * (127.0 * nx - normal[0]))
    normal[1] = round(normal[1] + rate * (127.0 * ny - normal[1]))


@jit
def insert(
    maps: Any,
    first: int,
    last: int,
    beams: Any,
    poses: NDArray[np.float64],
    own: NDArray[np.int32],
) -> None:
    """Adds the scan at `poses` (P, 3) to the maps of particles `first` to `last`.

    Only tiles of which `own` (S,) says that one particle has them are changed.
    """
    for particle in range(first, last):
        pose = poses[particle]
        cos, sin = math.cos(pose[2]), math.sin(pose[2])
        ox, oy = moved(pose, cos, sin, beams.origin)
        for i in range(beams.points.shape[0]):
            x, y = moved(pose, cos, sin, beams.points[i])
            _cross(maps, particle, ox, oy, x, y, own)
        for i in range(beams.points.shape[0]):
            x, y = moved(pose, cos, sin, beams.points[i])
            nx, ny = turned(cos, sin, beams.normals[i])
            _hit(maps, particle, x, y, nx, ny, own)
