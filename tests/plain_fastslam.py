"""FastSLAM with occupancy grids as the textbook prints it: to be read, and to test against.

Thrun, Burgard, Fox, "Probabilistic Robotics" (2005), table 13.4. It rests on
p(x_1:t, m | z_1:t, u_1:t) = p(x_1:t | z_1:t, u_1:t) * product over i of p(m_i | x_1:t, z_1:t):
particles for the path, and given the path every cell for itself. Every particle owns a whole grid
and every step visits all of it, so this is for small worlds; `fastslam.py` is for real ones.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from plain_measurement_model import MeasurementNoise, measurement_model_map
from plain_motion_model import MotionNoise, sample_motion_model
from plain_occupancy import SensorModel, update_occupancy_grid
from scipy.special import softmax

from mapmyworld.particles.filter import low_variance_sampler
from mapmyworld.types import OccupancyGrid, Scan


@dataclass(frozen=True, slots=True, eq=False)
class Particles:
    """Hypotheses of path and map."""

    x: NDArray[np.float64]
    """(P, T, 3) path of each particle so far."""
    m: tuple[OccupancyGrid, ...]
    """(P,) map of each particle."""
    log_w: NDArray[np.float64]
    """(P,) of the last measurement, before resampling."""


def fastslam_occupancy_grids(
    before: Particles,
    u: NDArray[np.float64],
    z: Scan,
    random: np.random.Generator,
    motion: MotionNoise,
    measurement: MeasurementNoise,
    sensor: SensorModel,
) -> Particles:
    """The particles after motion u_t (3,) and scan z_t: lines 1 to 12 of the table."""
    count = len(before.m)
    # Line 4: x_t^[k] ~ p(x_t | u_t, x_{t-1}^[k])
    x = sample_motion_model(u, before.x[:, -1], motion, random)
    # Line 5: w_t^[k] = p(z_t | x_t^[k], m_{t-1}^[k])
    log_w = np.array(
        [measurement_model_map(z, x[k], before.m[k], measurement) for k in range(count)]
    )
    # Line 6: m_t^[k], each cell by its log-odds l
    m = [update_occupancy_grid(z, x[k], before.m[k], sensor) for k in range(count)]
    # Lines 8 to 11: draw particles with probability proportional to w
    chosen = low_variance_sampler(softmax(log_w), count, float(random.random()))
    paths = np.concatenate([before.x, x[:, None]], axis=1)
    return Particles(paths[chosen], tuple(m[k] for k in chosen), log_w[chosen])


def run_plain_fastslam(
    steps: Iterable[tuple[NDArray[np.float64], Scan]],
    empty: OccupancyGrid,
    count: int,
    seed: int,
    motion: MotionNoise,
    measurement: MeasurementNoise,
    sensor: SensorModel,
) -> Particles:
    """All particles after steps (u, z); the first scan lies at the origin of `empty`'s map."""
    random = np.random.default_rng(seed)
    particles: Particles | None = None
    for u, z in steps:
        if particles is None:
            start = np.zeros(3)
            first = update_occupancy_grid(z, start, empty, sensor)
            particles = Particles(np.zeros((count, 1, 3)), (first,) * count, np.zeros(count))
        else:
            particles = fastslam_occupancy_grids(
                particles, u, z, random, motion, measurement, sensor
            )
    assert particles is not None, "no steps"
    return particles
