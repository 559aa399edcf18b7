"""How likely a scan is, at a pose in a map: the likelihood field and the beam model."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import distance_transform_edt

from mapmyworld.geometry.planar import compose_planar, transform_points_planar
from mapmyworld.types import OccupancyGrid, Scan


@dataclass(frozen=True, slots=True)
class MeasurementNoise:
    """Shares of the mixture, and the width of its Gaussian."""

    sigma: float = 0.1  # m
    hit: float = 0.8  # share of beams that end at the mapped surface
    short: float = 0.1  # share of beams that something unmapped cuts short
    chance: float = 0.1  # share of beams that end anywhere
    short_rate: float = 1.0  # 1/m, of what cuts beams short


def measurement_model_map(
    z: Scan, x: NDArray[np.float64], m: OccupancyGrid, noise: MeasurementNoise
) -> float:
    """Logarithm of p(z_t | x_t, m) by the likelihood field.

    Thrun, Burgard, Fox 2005, table 6.3: q is the product over beams of
    z_hit prob(dist, sigma_hit) + z_random / z_max, with dist from the end point to the nearest
    occupied cell. Beams without return are left out, as the table does.
    """
    ends = transform_points_planar(x, z.points)
    distance = _distances(ends, m)
    gauss = np.exp(-0.5 * (distance / noise.sigma) ** 2) / (np.sqrt(2.0 * np.pi) * noise.sigma)
    q = noise.hit * gauss + noise.chance / z.range_max
    return float(np.sum(np.log(q)))


def _distances(points: NDArray[np.float64], m: OccupancyGrid) -> NDArray[np.float64]:
    """Metres (N,) between the middles of a point's cell and the nearest occupied one."""
    occupied = np.nan_to_num(m.probabilities(), nan=0.5) >= m.occupied_threshold
    if not np.any(occupied):
        return np.full(len(points), np.inf)
    field = distance_transform_edt(~occupied) * m.resolution
    column, row = np.floor((points - m.origin) / m.resolution).astype(np.int64).T
    inside = (row >= 0) & (column >= 0) & (row < field.shape[0]) & (column < field.shape[1])
    row, column = np.where(inside, row, 0), np.where(inside, column, 0)
    return np.where(inside, field[row, column], np.inf)


def beam_range_finder_model(
    z: Scan, x: NDArray[np.float64], m: OccupancyGrid, noise: MeasurementNoise
) -> float:
    """Logarithm of p(z_t | x_t, m) by ray casting.

    Ibid., table 6.1: a mixture of p_hit about the expected range, p_short before it and p_rand
    (equations 6.4 to 6.11); beams without return are left out, and so is p_max.
    """
    lidar = compose_planar(x, z.origin)[:2]
    ends = transform_points_planar(x, z.points)
    q = np.ones(len(ends))
    for k, end in enumerate(ends):
        measured = float(np.hypot(*(end - lidar)))
        expected = expected_range(m, lidar, end, z.range_max)
        q[k] = noise.chance / z.range_max
        if expected is not None:
            q[k] += _hit_or_short(measured, expected, noise)
    return float(np.sum(np.log(q)))


def _hit_or_short(measured: float, expected: float, noise: MeasurementNoise) -> float:
    gauss = np.exp(-0.5 * ((measured - expected) / noise.sigma) ** 2)
    density = noise.hit * gauss / (np.sqrt(2.0 * np.pi) * noise.sigma)
    if measured <= expected:
        normaliser = 1.0 / (1.0 - np.exp(-noise.short_rate * expected))
        short = normaliser * noise.short_rate * np.exp(-noise.short_rate * measured)
        density += noise.short * short
    return float(density)


def expected_range(
    m: OccupancyGrid,
    lidar: NDArray[np.float64],
    towards: NDArray[np.float64],
    range_max: float,
) -> float | None:
    """Metres from the lidar (2,) to the first occupied cell in a direction; None where unknown."""
    direction = (towards - lidar) / max(float(np.hypot(*(towards - lidar))), 1e-9)
    ranges = np.arange(0.0, range_max, 0.5 * m.resolution)
    cells = (lidar + ranges[:, None] * direction - m.origin) / m.resolution
    column, row = np.floor(cells).astype(np.int64).T
    height, width = m.log_odds.shape
    inside = (row >= 0) & (column >= 0) & (row < height) & (column < width)
    count = int(np.argmin(inside)) if not np.all(inside) else len(inside)
    probability = m.probabilities()[row[:count], column[:count]]
    stops = np.flatnonzero(~(probability < m.occupied_threshold))
    if len(stops) == 0 or np.isnan(probability[stops[0]]):
        return None
    return float(ranges[stops[0]])
