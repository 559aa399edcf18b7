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
from numba import njit
from numpy.typing import NDArray

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
    """Metres a cell."""


class Beams(NamedTuple):
    """One scan, ready to be matched."""

    points: NDArray[np.float64]
    """(N, 2) end points, base frame."""
    normals: NDArray[np.float64]
    """(N, 2) unit normals towards the lidar; zero where unknown."""
    origin: NDArray[np.float64]
    """(2,) the lidar, base frame."""


@njit(cache=True, nogil=True)
def _slot(maps: Any, particle: int, ix: int, iy: int) -> int:
    ty = (iy >> TILE_SHIFT) - maps.base[0]
    tx = (ix >> TILE_SHIFT) - maps.base[1]
    if ty < 0 or tx < 0 or ty >= maps.tables.shape[1] or tx >= maps.tables.shape[2]:
        return 0
    return int(maps.tables[particle, ty, tx])


@njit(cache=True, nogil=True)
def _nearest(
    maps: Any, particle: int, x: float, y: float, nx: float, ny: float, reach: int
) -> tuple[float, float, float, float, float]:
    """Squared distance to the nearest surface cell's mean, that mean and its normal.

    Cells whose normal faces away from the beam's are passed over: a wall has two sides.
    """
    res = maps.resolution
    cx, cy = int(math.floor(x / res)), int(math.floor(y / res))
    best, qx, qy, mx, my = 1e9, 0.0, 0.0, 0.0, 0.0
    # Neighbouring cells mostly lie in the same tile, whose slot is looked up once.
    tile_x, tile_y = cx >> TILE_SHIFT, cy >> TILE_SHIFT
    slot = _slot(maps, particle, cx, cy)
    for ring in range(reach + 1):
        if ring > 1 and best <= ((ring - 1) * res) ** 2:
            break
        for dy in range(-ring, ring + 1):
            step = 1 if (dy == ring or dy == -ring) else 2 * ring
            for dx in range(-ring, ring + 1, max(step, 1)):
                ix, iy = cx + dx, cy + dy
                if ix >> TILE_SHIFT != tile_x or iy >> TILE_SHIFT != tile_y:
                    tile_x, tile_y = ix >> TILE_SHIFT, iy >> TILE_SHIFT
                    slot = _slot(maps, particle, ix, iy)
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


@njit(cache=True, nogil=True)
def _linearise(
    maps: Any,
    particle: int,
    beams: Any,
    pose: NDArray[np.float64],
    reach: int,
    sigma: float,
    H: NDArray[np.float64],
    g: NDArray[np.float64],
) -> float:
    """Adds the scan's Gauss-Newton system at `pose` to H (3, 3), g (3); returns the matched share.

    Residuals run along the normal where the map has one, else in both axes. Increments are
    those of the map frame, the rotation about the robot.
    """
    cos, sin = math.cos(pose[2]), math.sin(pose[2])
    limit = ((reach + 0.5) * maps.resolution) ** 2
    matched = 0.0
    inverse = 1.0 / (sigma * sigma)
    for i in range(beams.points.shape[0]):
        rx = cos * beams.points[i, 0] - sin * beams.points[i, 1]
        ry = sin * beams.points[i, 0] + cos * beams.points[i, 1]
        nx = cos * beams.normals[i, 0] - sin * beams.normals[i, 1]
        ny = sin * beams.normals[i, 0] + cos * beams.normals[i, 1]
        x, y = pose[0] + rx, pose[1] + ry
        d2, qx, qy, mx, my = _nearest(maps, particle, x, y, nx, ny, reach)
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
            matched += 1.0 / (1.0 + r * r * inverse)
        else:
            w = 0.25 * inverse / (1.0 + d2 * inverse) ** 2
            H[0, 0] += w
            H[0, 2] += -w * ry
            H[1, 1] += w
            H[1, 2] += w * rx
            H[2, 2] += w * (rx * rx + ry * ry)
            g[0] += w * ex
            g[1] += w * ey
            g[2] += w * (-ry * ex + rx * ey)
            matched += 1.0 / (1.0 + d2 * inverse)
    H[1, 0], H[2, 0], H[2, 1] = H[0, 1], H[0, 2], H[1, 2]
    return matched / max(beams.points.shape[0], 1)


@njit(cache=True, nogil=True)
def _solve(H: NDArray[np.float64], g: NDArray[np.float64], out: NDArray[np.float64]) -> None:
    """`out = -H^-1 g` of a positive definite 3x3 system, by Cramer's rule."""
    a, b, c = H[0, 0], H[0, 1], H[0, 2]
    d, e, f = H[1, 1], H[1, 2], H[2, 2]
    A, B, C = d * f - e * e, c * e - b * f, b * e - c * d
    determinant = a * A + b * B + c * C
    D, E, F = a * f - c * c, b * c - a * e, a * d - b * b
    out[0] = -(A * g[0] + B * g[1] + C * g[2]) / determinant
    out[1] = -(B * g[0] + D * g[1] + E * g[2]) / determinant
    out[2] = -(C * g[0] + E * g[1] + F * g[2]) / determinant


@njit(cache=True, nogil=True)
def _log_likelihood(
    maps: Any, particle: int, beams: Any, pose: NDArray[np.float64], reach: int, sigma: float
) -> float:
    """log p(z | x, m) of the likelihood field: every beam near a surface, or by chance."""
    cos, sin = math.cos(pose[2]), math.sin(pose[2])
    total = 0.0
    half = 0.5 / (sigma * sigma)
    for i in range(beams.points.shape[0]):
        x = pose[0] + cos * beams.points[i, 0] - sin * beams.points[i, 1]
        y = pose[1] + sin * beams.points[i, 0] + cos * beams.points[i, 1]
        nx = cos * beams.normals[i, 0] - sin * beams.normals[i, 1]
        ny = sin * beams.normals[i, 0] + cos * beams.normals[i, 1]
        d2, qx, qy, mx, my = _nearest(maps, particle, x, y, nx, ny, reach)
        if d2 < 1e8:
            length = math.sqrt(mx * mx + my * my)
            if length > PLANAR:
                along = (mx * (x - qx) + my * (y - qy)) / length
                d2 = 0.25 * d2 + 0.75 * along * along
        total += math.log(0.9 * math.exp(-half * d2) + 0.1)
    return total


@njit(cache=True, nogil=True)
def match(
    maps: Any,
    first: int,
    last: int,
    beams: Any,
    starts: NDArray[np.float64],
    prior: NDArray[np.float64],
    robust: float,
    reaches: NDArray[np.int64],
    sigma: float,
    scale: float,
    poses: NDArray[np.float64],
    informations: NDArray[np.float64],
    quality: NDArray[np.float64],
) -> None:
    """Most likely poses of particles `first` to `last`, given their maps and predictions.

    `starts` (P, K, 3): the prediction first, then other places to start from. `prior` (3, 3): the
    information of the prediction, in the map frame's axes turned to its heading. `robust`: the
    deviations after which the prediction counts less (0 = never). `reaches`: cells searched around
    an end point, for each iteration. `scale` turns sums over beams, which are not independent,
    into information. Fills `poses` (P, 3), `informations` (P, 3, 3) and `quality` (P, 3): matched
    share, log-likelihood of the scan, squared deviation from the prediction.
    """
    H, g, step = np.zeros((3, 3)), np.zeros(3), np.zeros(3)
    P, gap, pose = np.zeros((3, 3)), np.zeros(3), np.zeros(3)
    for particle in range(first, last):
        best = -1e18
        mean = starts[particle, 0]
        _turn_information(prior, mean[2], P)
        for k in range(starts.shape[1]):
            pose[:] = starts[particle, k]
            share = 0.0
            for iteration in range(reaches.shape[0]):
                H[:], g[:] = 0.0, 0.0
                # A wide search tolerates wide residuals.
                width = sigma * (1.0 + 0.5 * (reaches[iteration] - reaches[-1]))
                share = _linearise(maps, particle, beams, pose, reaches[iteration], width, H, g)
                H *= scale
                g *= scale
                squared = _deviation(pose, mean, P, gap)
                weight = 1.0 if robust <= 0.0 else 1.0 / (1.0 + squared / (robust * robust))
                if reaches[iteration] > reaches[-1]:
                    weight *= 0.02
                H += weight * P
                g += weight * (P[:, 0] * gap[0] + P[:, 1] * gap[1] + P[:, 2] * gap[2])
                _solve(H, g, step)
                pose += step
                small = abs(step[0]) + abs(step[1]) < 2e-4 and abs(step[2]) < 2e-5
                if small and reaches[iteration] == reaches[-1]:
                    break
            fit = _log_likelihood(maps, particle, beams, pose, reaches[-1], sigma)
            squared = _deviation(pose, mean, P, gap)
            if robust > 0.0:
                cost = 0.5 * robust * robust * math.log(1.0 + squared / (robust * robust))
            else:
                cost = 0.5 * squared
            if scale * fit - cost > best:
                best = scale * fit - cost
                poses[particle] = pose
                informations[particle] = H
                quality[particle, 0], quality[particle, 1] = share, fit
                quality[particle, 2] = squared


@njit(cache=True, nogil=True)
def _turn_information(prior: NDArray[np.float64], yaw: float, P: NDArray[np.float64]) -> None:
    """The information of a body-frame increment in the map frame's axes."""
    c, s = math.cos(yaw), math.sin(yaw)
    a, b, d = prior[0, 0], prior[0, 1], prior[1, 1]
    P[0, 0] = c * c * a - 2.0 * c * s * b + s * s * d
    P[1, 1] = s * s * a + 2.0 * c * s * b + c * c * d
    P[0, 1] = P[1, 0] = c * s * (a - d) + (c * c - s * s) * b
    P[0, 2] = P[2, 0] = c * prior[0, 2] - s * prior[1, 2]
    P[1, 2] = P[2, 1] = s * prior[0, 2] + c * prior[1, 2]
    P[2, 2] = prior[2, 2]


@njit(cache=True, nogil=True)
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


@njit(cache=True, nogil=True)
def log_likelihoods(
    maps: Any,
    first: int,
    last: int,
    beams: Any,
    poses: NDArray[np.float64],
    reach: int,
    sigma: float,
    out: NDArray[np.float64],
) -> None:
    """log p(z | x, m) (P,) of particles `first` to `last` by the likelihood field."""
    for particle in range(first, last):
        out[particle] = _log_likelihood(maps, particle, beams, poses[particle], reach, sigma)


@njit(cache=True, nogil=True)
def beam_log_likelihoods(
    maps: Any,
    first: int,
    last: int,
    beams: Any,
    poses: NDArray[np.float64],
    sigma: float,
    out: NDArray[np.float64],
) -> None:
    """log p(z | x, m) (P,) by the beam model: rays are followed to the first surface.

    Thrun et al. 2005, table 6.1, with a Gaussian about the expected range, a constant for
    what stands in the way and for chance, and no opinion where the ray leaves the known map.
    """
    half = 0.5 / (sigma * sigma)
    for particle in range(first, last):
        pose = poses[particle]
        cos, sin = math.cos(pose[2]), math.sin(pose[2])
        ox = pose[0] + cos * beams.origin[0] - sin * beams.origin[1]
        oy = pose[1] + sin * beams.origin[0] + cos * beams.origin[1]
        total = 0.0
        for i in range(beams.points.shape[0]):
            x = pose[0] + cos * beams.points[i, 0] - sin * beams.points[i, 1]
            y = pose[1] + sin * beams.points[i, 0] + cos * beams.points[i, 1]
            error = _ray_error(maps, particle, ox, oy, x, y, 4.0 * sigma)
            total += math.log(0.9 * math.exp(-half * error * error) + 0.1)
        out[particle] = total


@njit(cache=True, nogil=True)
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
        ix = int(math.floor((ox + ux * travelled) / maps.resolution))
        iy = int(math.floor((oy + uy * travelled) / maps.resolution))
        slot = _slot(maps, particle, ix, iy)
        cell = ((iy & MASK) << TILE_SHIFT) | (ix & MASK)
        hits = maps.hits[slot, cell]
        if hits > 0 and hits * 2 >= maps.visits[slot, cell]:
            px = (ix + maps.means[slot, cell, 0] / 255.0) * maps.resolution
            py = (iy + maps.means[slot, cell, 1] / 255.0) * maps.resolution
            expected = (px - ox) * ux + (py - oy) * uy
            return max(-beyond, min(beyond, expected - length))
        travelled += step
    return beyond


@njit(cache=True, nogil=True)
def touched_tiles(
    first: int,
    last: int,
    beams: Any,
    poses: NDArray[np.float64],
    base: NDArray[np.int64],
    resolution: float,
    out: NDArray[np.bool_],
) -> None:
    """Marks in `out` (P, H, W) the tiles that the scan's rays will change."""
    side = TILE * resolution
    for particle in range(first, last):
        pose = poses[particle]
        cos, sin = math.cos(pose[2]), math.sin(pose[2])
        ox = (pose[0] + cos * beams.origin[0] - sin * beams.origin[1]) / side - base[1]
        oy = (pose[1] + sin * beams.origin[0] + cos * beams.origin[1]) / side - base[0]
        for i in range(beams.points.shape[0]):
            x = (pose[0] + cos * beams.points[i, 0] - sin * beams.points[i, 1]) / side - base[1]
            y = (pose[1] + sin * beams.points[i, 0] + cos * beams.points[i, 1]) / side - base[0]
            out[particle, int(math.floor(y)), int(math.floor(x))] = True
            _mark_line(out[particle], ox, oy, x, y)


@njit(cache=True, nogil=True)
def _mark_line(out: NDArray[np.bool_], ox: float, oy: float, x: float, y: float) -> None:
    """Marks every cell of `out` that the segment crosses (Amanatides and Woo 1987)."""
    ix, iy = int(math.floor(ox)), int(math.floor(oy))
    ex, ey = int(math.floor(x)), int(math.floor(y))
    dx, dy = x - ox, y - oy
    sx, sy = (1 if dx > 0 else -1), (1 if dy > 0 else -1)
    tx = ((ix + (sx > 0)) - ox) / dx if dx != 0.0 else 1e18
    ty = ((iy + (sy > 0)) - oy) / dy if dy != 0.0 else 1e18
    out[iy, ix] = True
    for _ in range(abs(ex - ix) + abs(ey - iy)):
        if tx < ty:
            tx += sx / dx
            ix += sx
        else:
            ty += sy / dy
            iy += sy
        if ix < 0 or iy < 0 or iy >= out.shape[0] or ix >= out.shape[1]:
            return
        out[iy, ix] = True


@njit(cache=True, nogil=True)
def insert(
    maps: Any,
    first: int,
    last: int,
    beams: Any,
    poses: NDArray[np.float64],
    own: NDArray[np.int32],
) -> None:
    """Adds the scan at `poses` to the maps of particles `first` to `last`.

    Only tiles of which `own` (S,) says that one particle has them are changed.
    """
    for particle in range(first, last):
        pose = poses[particle]
        cos, sin = math.cos(pose[2]), math.sin(pose[2])
        ox = pose[0] + cos * beams.origin[0] - sin * beams.origin[1]
        oy = pose[1] + sin * beams.origin[0] + cos * beams.origin[1]
        for i in range(beams.points.shape[0]):
            x = pose[0] + cos * beams.points[i, 0] - sin * beams.points[i, 1]
            y = pose[1] + sin * beams.points[i, 0] + cos * beams.points[i, 1]
            _cross(maps, particle, ox, oy, x, y, own)
        for i in range(beams.points.shape[0]):
            x = pose[0] + cos * beams.points[i, 0] - sin * beams.points[i, 1]
            y = pose[1] + sin * beams.points[i, 0] + cos * beams.points[i, 1]
            nx = cos * beams.normals[i, 0] - sin * beams.normals[i, 1]
            ny = sin * beams.normals[i, 0] + cos * beams.normals[i, 1]
            _hit(maps, particle, x, y, nx, ny, own)


@njit(cache=True, nogil=True)
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
    ix, iy = int(math.floor(ox)), int(math.floor(oy))
    dx, dy = x - ox, y - oy
    sx, sy = (1 if dx > 0 else -1), (1 if dy > 0 else -1)
    tx = ((ix + (sx > 0)) - ox) / dx if dx != 0.0 else 1e18
    ty = ((iy + (sy > 0)) - oy) / dy if dy != 0.0 else 1e18
    stepx = sx / dx if dx != 0.0 else 1e18
    stepy = sy / dy if dy != 0.0 else 1e18
    for _ in range(abs(int(math.floor(x)) - ix) + abs(int(math.floor(y)) - iy) + 1):
        slot = _slot(maps, particle, ix, iy)
        if slot > 0 and own[slot] == 1:
            cell = ((iy & MASK) << TILE_SHIFT) | (ix & MASK)
            _visit(maps, slot, cell)
        if tx < ty:
            tx += stepx
            ix += sx
        else:
            ty += stepy
            iy += sy


@njit(cache=True, nogil=True)
def _visit(maps: Any, slot: int, cell: int) -> None:
    if maps.visits[slot, cell] == FULL:
        maps.visits[slot, cell] = FULL >> 1
        maps.hits[slot, cell] >>= 1
    maps.visits[slot, cell] += 1


@njit(cache=True, nogil=True)
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
    ix, iy = int(math.floor(x / res)), int(math.floor(y / res))
    slot = _slot(maps, particle, ix, iy)
    if slot == 0 or own[slot] != 1:
        return
    cell = ((iy & MASK) << TILE_SHIFT) | (ix & MASK)
    _visit(maps, slot, cell)
    maps.hits[slot, cell] += 1
    rate = 1.0 / min(float(maps.hits[slot, cell]), float(MEMORY))
    fx, fy = (x / res - ix) * 255.0, (y / res - iy) * 255.0
    mean, normal = maps.means[slot, cell], maps.normals[slot, cell]
    mean[0] = int(round(mean[0] + rate * (fx - mean[0])))
    mean[1] = int(round(mean[1] + rate * (fy - mean[1])))
    normal[0] = int(round(normal[0] + rate * (127.0 * nx - normal[0])))
    normal[1] = int(round(normal[1] + rate * (127.0 * ny - normal[1])))


@njit(cache=True, nogil=True)
def mark_path(
    points: NDArray[np.float64],
    ends: NDArray[np.int64],
    poses: NDArray[np.float64],
    base: NDArray[np.int64],
    resolution: float,
    out: NDArray[np.bool_],
) -> None:
    """Marks in `out` (H, W) the tiles in which scans at `poses` (K, 3) end."""
    side = TILE * resolution
    for k in range(len(poses)):
        cos, sin = math.cos(poses[k, 2]), math.sin(poses[k, 2])
        for i in range(ends[k], ends[k + 1]):
            x = (poses[k, 0] + cos * points[i, 0] - sin * points[i, 1]) / side - base[1]
            y = (poses[k, 1] + sin * points[i, 0] + cos * points[i, 1]) / side - base[0]
            out[int(math.floor(y)), int(math.floor(x))] = True


@njit(cache=True, nogil=True)
def insert_path(
    maps: Any,
    points: NDArray[np.float64],
    normals: NDArray[np.float64],
    ends: NDArray[np.int64],
    poses: NDArray[np.float64],
    own: NDArray[np.int32],
) -> None:
    """Adds the end points of scans at `poses` (K, 3) to the one map there is."""
    for k in range(len(poses)):
        cos, sin = math.cos(poses[k, 2]), math.sin(poses[k, 2])
        for i in range(ends[k], ends[k + 1]):
            x = poses[k, 0] + cos * points[i, 0] - sin * points[i, 1]
            y = poses[k, 1] + sin * points[i, 0] + cos * points[i, 1]
            nx = cos * normals[i, 0] - sin * normals[i, 1]
            ny = sin * normals[i, 0] + cos * normals[i, 1]
            _hit(maps, 0, x, y, nx, ny, own)


@njit(cache=True, nogil=True)
def linearise_path(
    maps: Any,
    first: int,
    last: int,
    points: NDArray[np.float64],
    normals: NDArray[np.float64],
    ends: NDArray[np.int64],
    poses: NDArray[np.float64],
    reach: int,
    sigma: float,
    H: NDArray[np.float64],
    g: NDArray[np.float64],
    share: NDArray[np.float64],
) -> None:
    """Gauss-Newton systems (K, 3, 3), (K, 3) of the scans `first` to `last` in one map.

    `ends` (K + 1,): scan k's beams are `points[ends[k]:ends[k + 1]]`.
    """
    origin = np.zeros(2)
    for k in range(first, last):
        beams = Beams(points[ends[k] : ends[k + 1]], normals[ends[k] : ends[k + 1]], origin)
        share[k] = _linearise(maps, 0, beams, poses[k], reach, sigma, H[k], g[k])
