"""Scans written into maps: which tiles they change, and how."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mapmyworld.kernels.compiling import inner_jit, jit
from mapmyworld.particles.kernels.surface_tiles import (
    FULL,
    MASK,
    MEMORY,
    TILE,
    TILE_SHIFT,
    moved,
    slot_of,
    turned,
)


@inner_jit
def _mark_line(
    tiles: NDArray[np.int32], ox: float, oy: float, x: float, y: float, out: NDArray[np.bool_]
) -> None:
    """Marks every tile there is that the segment crosses (Amanatides and Woo 1987)."""
    ix, iy = math.floor(ox), math.floor(oy)
    ex, ey = math.floor(x), math.floor(y)
    dx, dy = x - ox, y - oy
    sx, sy = (1 if dx > 0 else -1), (1 if dy > 0 else -1)
    tx = ((ix + (sx > 0)) - ox) / dx if dx != 0.0 else 1e18
    ty = ((iy + (sy > 0)) - oy) / dy if dy != 0.0 else 1e18
    out[iy, ix] |= tiles[iy, ix] > 0
    for _ in range(abs(ex - ix) + abs(ey - iy)):
        if tx < ty:
            tx += sx / dx
            ix += sx
        else:
            ty += sy / dy
            iy += sy
        if ix < 0 or iy < 0 or iy >= out.shape[0] or ix >= out.shape[1]:
            return
        out[iy, ix] |= tiles[iy, ix] > 0


@jit
def touched_tiles(
    first: int,
    last: int,
    tables: NDArray[np.int32],
    beams: Any,
    poses: NDArray[np.float64],
    base: NDArray[np.int64],
    resolution: float,
    out: NDArray[np.bool_],
) -> None:
    """Marks in `out` (P, H, W) the tiles that the scan will change, seen from `poses` (P, 3).

    `tables` (P, H, W) hold the slots of the particles' tiles, the first of which is row, column
    `base` (2,). Those in which beams end, and of those that are only crossed the ones that already
    hold something: free space alone is nothing to match with.
    """
    side = TILE * resolution
    for particle in range(first, last):
        pose = poses[particle]
        cos, sin = math.cos(pose[2]), math.sin(pose[2])
        ox, oy = moved(pose, cos, sin, beams.origin)
        ox, oy = ox / side - base[1], oy / side - base[0]
        for i in range(beams.points.shape[0]):
            x, y = moved(pose, cos, sin, beams.points[i])
            x, y = x / side - base[1], y / side - base[0]
            _mark_line(tables[particle], ox, oy, x, y, out[particle])
            out[particle, math.floor(y), math.floor(x)] = True


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
    x, y = (ox + keep * (x - ox)) / res, (oy + keep * (y - oy)) / res
    ox, oy = ox / res, oy / res
    ix, iy = math.floor(ox), math.floor(oy)
    dx, dy = x - ox, y - oy
    sx, sy = (1 if dx > 0 else -1), (1 if dy > 0 else -1)
    tx = ((ix + (sx > 0)) - ox) / dx if dx != 0.0 else 1e18
    ty = ((iy + (sy > 0)) - oy) / dy if dy != 0.0 else 1e18
    stepx = sx / dx if dx != 0.0 else 1e18
    stepy = sy / dy if dy != 0.0 else 1e18
    tile_x, tile_y = ix >> TILE_SHIFT, iy >> TILE_SHIFT
    slot = slot_of(maps, particle, ix, iy)
    mine = slot > 0 and own[slot] == 1
    for _ in range(abs(math.floor(x) - ix) + abs(math.floor(y) - iy) + 1):
        if ix >> TILE_SHIFT != tile_x or iy >> TILE_SHIFT != tile_y:
            tile_x, tile_y = ix >> TILE_SHIFT, iy >> TILE_SHIFT
            slot = slot_of(maps, particle, ix, iy)
            mine = slot > 0 and own[slot] == 1
        if mine:
            cell = ((iy & MASK) << TILE_SHIFT) | (ix & MASK)
            _visit(maps, slot, cell)
        if tx < ty:
            tx += stepx
            ix += sx
        else:
            ty += stepy
            iy += sy


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
