"""A grid of independent cells, updated by Bayes' rule in log-odds."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from mapmyworld.geometry.planar import compose_planar, transform_points_planar
from mapmyworld.types import OccupancyGrid, Scan


@dataclass(frozen=True, slots=True)
class SensorModel:
    """What one beam indicates about a cell: p(m_i | x_t, z_t)."""

    p_occupied: float = 0.7
    """Of the cell in which the beam ends."""
    p_free: float = 0.4
    """Of a cell that it crosses."""
    limit: float = 6.0
    """Log-odds that a cell never exceeds, so that it can change its mind."""


def log_odds(p: float) -> float:
    """The logarithm l of p / (1 - p)."""
    return float(np.log(p / (1.0 - p)))


def update_occupancy_grid(
    z: Scan, x: NDArray[np.float64], m: OccupancyGrid, sensor: SensorModel
) -> OccupancyGrid:
    """The grid after one more scan z at pose x (3,).

    Thrun, Burgard, Fox 2005, table 9.1: l_{t,i} = l_{t-1,i} + inverse_sensor_model(m_i, x_t, z_t)
    - l_0 for every cell i in the field of perception. Here l_0 = 0: a cell is as likely free as
    occupied before it is seen.
    """
    l_scan = inverse_sensor_model(z, x, m, sensor)
    seen = ~np.isnan(l_scan)
    l_new = m.log_odds.copy()
    l_new[seen] = np.nan_to_num(m.log_odds[seen]) + l_scan[seen]
    return replace(m, log_odds=np.clip(l_new, -sensor.limit, sensor.limit))


def inverse_sensor_model(
    z: Scan, x: NDArray[np.float64], m: OccupancyGrid, sensor: SensorModel
) -> NDArray[np.float32]:
    """Log-odds (H, W) of p(m_i | x_t, z_t); NaN outside the field of perception.

    Table 9.2, with beams as lines rather than cones: cells that a beam crosses are free, the one in
    which it ends is occupied. A scan is one measurement of a cell, whatever the number of its beams
    there, and an end counts more than a crossing.
    """
    lidar = compose_planar(x, z.origin)[:2]
    out = np.full(m.log_odds.shape, np.nan, np.float32)
    ends = transform_points_planar(x, z.points)
    for end in ends:
        _write(out, cells_crossed(lidar, end, m)[:-1], log_odds(sensor.p_free))
    _write(out, np.array([cell_of(end, m) for end in ends]), log_odds(sensor.p_occupied))
    return out


def cell_of(point: NDArray[np.float64], m: OccupancyGrid) -> NDArray[np.int64]:
    """Row and column (2,) of the cell in which a point (2,) lies."""
    column, row = np.floor((point - m.origin) / m.resolution)
    return np.array([row, column], np.int64)


def cells_crossed(
    a: NDArray[np.float64], b: NDArray[np.float64], m: OccupancyGrid
) -> NDArray[np.int64]:
    """Rows and columns (N, 2) of the cells that the segment from a to b crosses, in order.

    Between two neighbouring crossings of grid lines lies one cell.
    """
    start, end = (a - m.origin) / m.resolution, (b - m.origin) / m.resolution
    crossings = [np.array([0.0, 1.0])]
    for p, q in zip(start, end, strict=True):
        lines = np.arange(np.ceil(min(p, q)), np.floor(max(p, q)) + 1.0)
        if p != q:
            crossings.append((lines - p) / (q - p))
    shares = np.unique(np.clip(np.concatenate(crossings), 0.0, 1.0))
    middles = 0.5 * (shares[1:] + shares[:-1])
    cells = np.floor(start + middles[:, None] * (end - start)).astype(np.int64)[:, ::-1]
    anew = np.any(np.diff(cells, axis=0) != 0, axis=1)  # crossings may be one but for rounding
    return cells[np.concatenate([[True], anew])]


def _write(out: NDArray[np.float32], cells: NDArray[np.int64], value: float) -> None:
    cells = cells.reshape(-1, 2)
    inside = np.all((cells >= 0) & (cells < np.array(out.shape)), axis=1)
    out[cells[inside, 0], cells[inside, 1]] = value
